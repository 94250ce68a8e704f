"""Tables as Parquet, CSV and Arrow files: bodies, and in files beside it contacts and energies.

Parquet and Arrow have the units in the metadata of their fields, CSV in its header.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.csv as pc
import pyarrow.parquet as pq

from carom.recording.export import CONTACTS, ENERGIES, Snapshot, beside
from carom.recording.export.spreadsheet import in_csv
from carom.recording.read.state_columns import state_table, with_units


def write_parquet(path: Path, first: Snapshot, others: Iterator[Snapshot]) -> None:
    """Write Parquet files, with a row group for each step."""
    _write(pq.ParquetWriter, path, first, others)


def write_arrow(path: Path, first: Snapshot, others: Iterator[Snapshot]) -> None:
    """Write Arrow files (Feather), with a record batch for each step."""
    _write(pa.ipc.new_file, path, first, others)


def write_csv(path: Path, first: Snapshot, others: Iterator[Snapshot]) -> None:
    """Write CSV files with a header; numbers keep all their digits."""
    _write(pc.CSVWriter, path, first, others, in_csv)


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


def table_of(snapshot: Snapshot) -> pa.Table:
    """Tabulate the bodies of a snapshot."""
    table = state_table([snapshot.step], [snapshot.time], [snapshot.vectors])
    own = {"body": snapshot.body, "mass": snapshot.mass, "radius": snapshot.radius, **snapshot.others}
    for place, (name, values) in enumerate(own.items(), start=2):  # after step and time
        table = table.add_column(place, name, pa.array(values))
    return with_units(table)


def energies_of(snapshot: Snapshot) -> pa.Table:
    """Tabulate the energies of a snapshot (J), with the ledger and the integration error."""
    row = {"step": snapshot.step, "time": snapshot.time, **snapshot.energies}
    units = {"time": "s", **dict.fromkeys(snapshot.energies, "J")}
    return with_units(pa.table({name: [value] for name, value in row.items()}), units)
