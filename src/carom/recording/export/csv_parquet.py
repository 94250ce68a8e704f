"""Tables with one row per body and step: Parquet and CSV, by pyarrow."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pyarrow as pa
import pyarrow.csv as pc
import pyarrow.parquet as pq

from carom.recording.export.spreadsheet import harmless
from carom.recording.read.tables import state_table

if TYPE_CHECKING:
    from carom.recording.export import Snapshot


def write_parquet(path: Path, first: Snapshot, others: Iterator[Snapshot]) -> None:
    """Write a Parquet file, with a row group for each step."""
    _write(pq.ParquetWriter, path, first, others)


def write_csv(path: Path, first: Snapshot, others: Iterator[Snapshot]) -> None:
    """Write a CSV file with a header; numbers keep all their digits."""
    _write(pc.CSVWriter, path, first, others, harmless)


def _write(
    writer_of: Callable[..., Any],
    path: Path,
    first: Snapshot,
    others: Iterator[Snapshot],
    shaped: Callable[[pa.Table], pa.Table] = lambda table: table,
) -> None:
    table = shaped(table_of(first))
    with writer_of(path, table.schema) as writer:
        writer.write_table(table)
        for snapshot in others:
            writer.write_table(shaped(table_of(snapshot)))


def table_of(snapshot: Snapshot) -> pa.Table:
    """Tabulate a snapshot."""
    table = state_table([snapshot.state], snapshot.body)
    own = {"body": snapshot.body, "mass": snapshot.mass, "radius": snapshot.radius, **snapshot.others}
    for place, (name, values) in enumerate(own.items(), start=2):  # after step and time
        table = table.add_column(place, name, pa.array(values))
    return table
