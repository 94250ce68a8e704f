"""Tables as Parquet, CSV and Arrow files: a file of the bodies, and beside it files of contacts and energies.

Parquet and Arrow store units in the metadata of their fields, CSV stores them in its header.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.csv as pc
import pyarrow.parquet as pq

from carom.recording.export import CONTACTS, ENERGIES, Snapshot, TableFiles, beside
from carom.recording.export.spreadsheet import in_csv
from carom.recording.read.state_columns import state_table, with_units


def _write(
    writer_of: Callable[..., Any],
    path: Path,
    first: Snapshot,
    others: Iterator[Snapshot],
    shaped: Callable[[pa.Table], pa.Table] = lambda table: table,
) -> None:
    with ExitStack() as stack:
        writers = dict[Path, Any]()
        for snapshot in (first, *others):
            tables = {path: table_of(snapshot), beside(path, ENERGIES): energies_of(snapshot)}
            if snapshot.contacts is not None:
                tables[beside(path, CONTACTS)] = snapshot.contacts
            for file, table in tables.items():
                shown = shaped(table)
                if file not in writers:
                    writers[file] = stack.enter_context(writer_of(file, shown.schema))
                writers[file].write_table(shown)


PARQUET = TableFiles(partial(_write, pq.ParquetWriter))  # Parquet, with a row group for each step
ARROW = TableFiles(partial(_write, pa.ipc.new_file))  # Feather, with a record batch for each step
CSV = TableFiles(partial(_write, pc.CSVWriter, shaped=in_csv))  # CSV, in which numbers keep all their digits


def table_of(snapshot: Snapshot) -> pa.Table:
    """Tabulate the bodies of a snapshot."""
    table = state_table([snapshot.step], [snapshot.time], [snapshot.vectors])
    own = {"body": snapshot.body, "mass": snapshot.mass, "radius": snapshot.radius, **snapshot.others}
    for place, (name, values) in enumerate(own.items(), start=2):  # these columns come after step and time
        table = table.add_column(place, name, pa.array(values))
    return with_units(table)


def energies_of(snapshot: Snapshot) -> pa.Table:
    """Tabulate the energies of a snapshot (J), with the ledger and the integration error."""
    row = {"step": snapshot.step, "time": snapshot.time, **snapshot.energies}
    units = {"time": "s", **dict.fromkeys(snapshot.energies, "J")}
    return with_units(pa.table({name: [value] for name, value in row.items()}), units)
