"""Tables with a row for each body and step: Parquet and CSV, by pyarrow."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv as pc
import pyarrow.parquet as pq

from carom.recording.export.snapshot import Snapshot
from carom.recording.read.body_states import AXES


def write_parquet(path: Path, first: Snapshot, others: Iterator[Snapshot]) -> None:
    """Write a Parquet file, a row group for each step."""
    table = table_of(first)
    with pq.ParquetWriter(path, table.schema) as writer:
        writer.write_table(table)
        for snapshot in others:
            writer.write_table(table_of(snapshot))


def write_csv(path: Path, first: Snapshot, others: Iterator[Snapshot]) -> None:
    """Write a CSV file with a header; numbers keep all their digits."""
    table = table_of(first)
    with pc.CSVWriter(path, table.schema) as writer:
        writer.write_table(table)
        for snapshot in others:
            writer.write_table(table_of(snapshot))


def table_of(snapshot: Snapshot) -> pa.Table:
    """Tabulate a snapshot."""
    n = len(snapshot)
    columns = {
        "step": np.full(n, snapshot.step),
        "time": np.full(n, snapshot.time),
        "body": np.arange(n),
        "mass": snapshot.mass,
        "radius": snapshot.radius,
    }
    for name, values in snapshot.vectors.items():
        columns |= dict(zip(AXES[name], np.ascontiguousarray(values.T), strict=True))
    return pa.table(columns)
