"""Writes the bodies of a recording into a file; its suffix selects a format of `carom.registry`."""

from __future__ import annotations

import itertools
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from numpy.typing import NDArray

from carom import registry
from carom.arrays import FloatArray, IntArray
from carom.errors import ExistsError, RecordingError
from carom.recording.read.tables import AXES

if TYPE_CHECKING:
    from carom.physics.checkpoint import Checkpoint


@dataclass(frozen=True, slots=True)
class Snapshot:
    """The bodies that exist and that a recording shows, at the end of a step, in float64 and SI units."""

    state: Checkpoint  # the state of all bodies
    body: IntArray  # (n,) numbers of the shown bodies
    mass: FloatArray  # (n,) kg
    radius: FloatArray  # (n,) m
    others: Mapping[str, NDArray[Any]]  # (n,) further columns that a [[bodies]] section needs
    cell: FloatArray | None = None  # (3,) m, size of a periodic domain about the origin; or (3, 3) m, see `Shear.cell`

    @property
    def step(self) -> int:
        """The number of the step."""
        return self.state.step

    @property
    def time(self) -> float:
        """The time at its end in s."""
        return self.state.time

    @property
    def vectors(self) -> dict[str, FloatArray]:
        """The state by quantity, (n, k) each; without orientation and spin where they are not modelled."""
        return {name: getattr(self.state, name)[self.body] for name in AXES if getattr(self.state, name) is not None}

    def __len__(self) -> int:
        return len(self.mass)


VTK = ".vtk"  # the only format that holds a single step
SERIES = ".series"  # appended to the name of a .vtk of many steps


def refuse_format(path: Path, formats: Sequence[str] | None = None) -> None:
    """Raise RecordingError if the suffix of a file names no format, by default of `carom.registry`."""
    if formats is None:
        formats = [f".{name}" for name in registry.names("export_formats")]
    if path.suffix not in formats:
        known = ", ".join(formats)
        raise RecordingError(f'{path}: the format "{path.suffix}" is unknown; known suffixes: {known}')


def refuse_series(path: Path, force: bool) -> None:
    """Raise RecordingError if the folder of a .vtk of many steps exists, unless its files may be replaced."""
    folder = series_of(path)[1]
    if folder.exists() and not (force and folder.is_dir()):
        raise ExistsError(folder)


def write(path: Path, snapshots: Iterator[Snapshot], series: bool) -> tuple[Path, int]:
    """Write snapshots to a file that appears when it is complete; return its path and the number of steps.

    A .vtk holds one step. Several steps go into a folder ``NAME-vtk`` beside ``NAME.vtk.series``, which lists their
    times. Raises RecordingError if it cannot be written.
    """
    numbers = itertools.count()  # the next one is the number of steps that have been written
    counted = (snapshot for snapshot, _ in zip(snapshots, numbers, strict=False))
    try:
        with tempfile.TemporaryDirectory(dir=path.parent, prefix=f".{path.name}.") as folder:
            part = Path(folder) / path.name
            if path.suffix == VTK and series:
                return _write_series(path, counted, Path(folder)), next(numbers)
            first = next(counted)
            write_steps = registry.load("export_formats", path.suffix[1:])
            write_steps(part, first) if path.suffix == VTK else write_steps(part, first, counted)
            part.replace(path)
    except OSError as error:
        raise RecordingError(f"cannot write {path}: {error.strerror or error}") from error
    return path, next(numbers)


def series_of(path: Path) -> tuple[Path, Path]:
    """Return the list and the folder of a .vtk of many steps."""
    return path.with_name(path.name + SERIES), path.with_name(f"{path.stem}-vtk")


def _write_series(path: Path, snapshots: Iterator[Snapshot], scratch: Path) -> Path:
    from carom.recording.export.vtk import write_vtk_series  # noqa: PLC0415 - a format that may have been removed

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
