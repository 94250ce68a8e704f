"""Writes the bodies of a recording into a file; its suffix selects a format of `carom.registry`."""

from __future__ import annotations

import itertools
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from carom import registry
from carom.arrays import BoolArray, FloatArray, IntArray
from carom.errors import ExistsError, RecordingError
from carom.recording.read.lookup import tolerance
from carom.recording.read.recording import Recording
from carom.recording.read.tables import AXES
from carom.recording.schema.paths import STEP

if TYPE_CHECKING:
    from carom.physics.checkpoint import Checkpoint
    from carom.runs.window import Watcher


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


def snapshots(
    recording: Recording, at: float | None, *, everything: bool, watch: Watcher | None = None
) -> Iterator[Snapshot]:
    """Yield the state at a time (s), or all recorded frames; steps between checkpoints are recomputed.

    Raises RecordingError if there is no such moment, or a rerun does not give the same bits.
    """
    table = recording.fingerprints()
    times, steps = table["time"].to_numpy(), table[STEP].to_numpy()
    recording.require_frames()
    moment = float(times[0]) if everything else recording.moment(at)
    goal = min(moment - tolerance(moment), float(times[-1]))
    if recording.engine:
        yield from _kept(recording, steps if everything else steps[[int(np.searchsorted(times, goal))]])
        return
    window = recording.rerun(goal, watch=watch)
    own = _own(recording, window.fixed)
    wanted, left = (set(steps.tolist()), len(steps)) if everything else (set[int](), 1)
    frames = window.frames(np.inf if everything else goal)
    chosen = (frame for frame in frames if (frame.step in wanted if everything else frame.time >= goal))
    for frame in itertools.islice(chosen, left):
        if window.differs is not None:
            raise RecordingError(f"{recording.path}: the rerun has different bits from step {window.differs} on")
        left -= 1
        yield Snapshot(frame.checkpoint, *own, window.cell(frame.time))
    if left:
        raise RecordingError(f"{recording.path} ends earlier when it is rerun; its bits differ")


def _kept(recording: Recording, steps: IntArray) -> Iterator[Snapshot]:
    """Yield the exact states of some frames of a run that cannot be repeated."""
    body, mass, radius, others = _own(recording, np.zeros(len(recording.bodies.mass), np.bool_))
    kept = recording.checkpoint_times
    if missing := [int(step) for step in steps if step not in kept]:
        raise RecordingError(
            f"{recording.path} has no exact state at step {missing[0]} and cannot be rerun; record with exact=True"
        )
    for state in recording.checkpoints(steps.tolist()):
        there = recording.present(state.step)[body]
        own = {name: values[there] for name, values in others.items()}
        yield Snapshot(state, body[there], mass[there], radius[there], own)


def _own(recording: Recording, fixed: BoolArray) -> tuple[IntArray, FloatArray, FloatArray, dict[str, NDArray[Any]]]:
    """Return numbers, masses and radii of the shown bodies, and further columns that differ from the defaults."""
    bodies, shown, found = recording.bodies, np.array(recording.shown, dtype=np.int64), dict[str, NDArray[Any]]()
    mass, radius, inertia = (np.asarray(each)[shown] for each in (bodies.mass, bodies.radius, bodies.inertia))
    if not np.allclose(inertia, 0.4 * mass * radius * radius, rtol=1e-12, atol=0.0):
        found["inertia"] = inertia
    if fixed[shown].any():
        found["fixed"] = fixed[shown]
    names = [bodies.name[body] for body in recording.shown]
    if any(name != f"body {row}" for row, name in enumerate(names)):
        found["name"] = np.array(names, dtype=np.str_)
    return shown, mass, radius, found


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
