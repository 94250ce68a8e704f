"""Writes bodies of a recording into a file whose ending names the format, one of `carom.registry`."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path

from carom import registry
from carom.errors import ExistsError, RecordingError
from carom.recording.export.snapshot import Snapshot
from carom.recording.export.vtk import write_vtk, write_vtk_series

VTK = ".vtk"  # the one format whose files hold a single step
SERIES = ".series"  # appended to the name of a .vtk of many steps


def refuse_format(path: Path, formats: Sequence[str] | None = None) -> None:
    """Raise RecordingError if the ending of a file names no format; by default one of `carom.registry`."""
    if formats is None:
        formats = [f".{name}" for name in registry.names("export_formats")]
    if path.suffix not in formats:
        known = ", ".join(formats)
        raise RecordingError(f'{path}: the format "{path.suffix}" is unknown; known endings: {known}')


def refuse_series(path: Path, force: bool) -> None:
    """Raise RecordingError if the folder of a .vtk of many steps is there, unless its files may be replaced."""
    folder = series_of(path)[1]
    if folder.exists() and not (force and folder.is_dir()):
        raise ExistsError(folder)


def write(path: Path, snapshots: Iterator[Snapshot], series: bool) -> tuple[Path, int]:
    """Write snapshots into a file that appears when it is complete; return what was written and how many steps.

    A .vtk holds one step. Several go into a folder ``NAME-vtk`` beside ``NAME.vtk.series``, which lists their times.

    Raises
    ------
    RecordingError
        If it cannot be written.
    """
    counted = _Counted(snapshots)
    try:
        with tempfile.TemporaryDirectory(dir=path.parent, prefix=f".{path.name}.") as folder:
            part = Path(folder) / path.name
            if path.suffix == VTK and series:
                return _write_series(path, counted, Path(folder)), counted.count
            first = next(counted)
            if path.suffix == VTK:
                write_vtk(part, first)
            else:
                registry.load("export_formats", path.suffix[1:])(part, first, counted)
            part.replace(path)
    except OSError as error:
        raise RecordingError(f"cannot write {path}: {error.strerror or error}") from error
    return path, counted.count


def series_of(path: Path) -> tuple[Path, Path]:
    """Return the list and the folder of a .vtk of many steps."""
    return path.with_name(path.name + SERIES), path.with_name(f"{path.stem}-vtk")


def _write_series(path: Path, snapshots: Iterator[Snapshot], scratch: Path) -> Path:
    listed, folder = series_of(path)
    filling = scratch / folder.name
    filling.mkdir()
    write_vtk_series(scratch / listed.name, snapshots, filling, path.stem)
    folder.mkdir(exist_ok=True)
    for old in folder.glob(f"{path.stem}-*{VTK}"):
        old.unlink()
    for file in filling.iterdir():
        file.replace(folder / file.name)
    (scratch / listed.name).replace(listed)
    return listed


class _Counted(Iterator[Snapshot]):
    """Counts the snapshots that are taken."""

    def __init__(self, snapshots: Iterator[Snapshot]) -> None:
        self._snapshots = snapshots
        self.count = 0

    def __next__(self) -> Snapshot:
        snapshot = next(self._snapshots)
        self.count += 1
        return snapshot
