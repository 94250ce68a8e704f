"""The export format .positions: a line with the time, and a line with the coordinates of each body."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from carom.extend import Snapshot


def write_positions(path: Path, first: Snapshot, others: Iterator[Snapshot]) -> None:
    """Write all steps into one file, in metres and seconds."""
    with path.open("w", encoding="utf-8") as file:
        for snapshot in (first, *others):
            file.write(f"{snapshot.time!r}\n")
            file.writelines(f"{x!r} {y!r} {z!r}\n" for x, y, z in snapshot.vectors["position"].tolist())
