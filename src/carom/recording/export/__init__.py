"""Writes the bodies of a recording into a file, whose suffix selects a format of `carom.registry`."""

from __future__ import annotations

import itertools
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pyarrow as pa
from numpy.typing import NDArray

from carom import registry
from carom.arrays import FloatArray, IntArray
from carom.errors import ExistsError, RecordingError
from carom.recording.read.state_columns import VectorsByName
from carom.recording.write.whole_file import refuse_output
from carom.scene.wording import nearest


@dataclass(frozen=True, slots=True)
class Snapshot:
    """The bodies that exist and that a recording shows, at the end of a step, in float64 and SI units."""

    step: int
    time: float  # s, time at the end of the step
    body: IntArray  # (n,) numbers of the shown bodies
    mass: FloatArray  # (n,) kg
    radius: FloatArray  # (n,) m
    others: Mapping[str, NDArray[Any]]  # (n,) each, further columns that a [[bodies]] section needs
    vectors: VectorsByName  # quantities of the state that are modelled, (n, k) each; see `STATE_QUANTITIES`
    energies: Mapping[str, float]  # J, energies of all bodies, by the names of `Recording.energy`
    # contacts of the step, with names and units, see `Recording.contacts`; None if they are not known
    contacts: pa.Table | None = None
    cell: FloatArray | None = None  # (3,) m, size of a periodic domain about the origin; or (3, 3) m, see `Shear.cell`

    def __len__(self) -> int:
        return len(self.mass)


@dataclass(frozen=True, slots=True)
class StepFiles:
    """A format with a file for each step; other formats are functions of a path, the first step and the later steps."""

    write: Callable[[Path, Snapshot], None]
    write_list: Callable[[Path, Sequence[tuple[str, float]]], None]  # writes the names of files, and their times in s
    list_suffix: str  # suffix of the list, after the requested name


CONTACTS, ENERGIES = "contacts", "energies"  # names of the tables beside the table of bodies


@dataclass(frozen=True, slots=True)
class TableFiles:
    """A format with a file for each table: bodies and, beside this file, contacts and energies."""

    write: Callable[[Path, Snapshot, Iterator[Snapshot]], None]

    def __call__(self, path: Path, first: Snapshot, others: Iterator[Snapshot]) -> None:
        """Write all steps."""
        self.write(path, first, others)


def others_of(path: Path) -> list[Path]:
    """Return the files of the tables beside the table of the bodies."""
    has_others = isinstance(registry.load("export_formats", path.suffix[1:]), TableFiles)
    return [beside(path, part) for part in (CONTACTS, ENERGIES)] if has_others else []


def beside(path: Path, part: str) -> Path:
    """Return the file of another table, beside the file of the table of bodies."""
    return path.with_name(f"{path.stem}-{part}{path.suffix}")


def refuse_format(path: Path, formats: Sequence[str] | None = None) -> None:
    """Raise RecordingError if a file's suffix names none of the formats, by default those of `carom.registry`."""
    if formats is None:
        formats = [f".{name}" for name in registry.names("export_formats")]
    if path.suffix not in formats:
        near = nearest(path.suffix.lstrip("."), [name.lstrip(".") for name in formats])
        there = f'did you mean ".{near}"? There' if near else "there"
        raise RecordingError(f'{path}: the format "{path.suffix}" is unknown; {there} are {", ".join(formats)}')


def refuse_export(path: Path, everything: bool, force: bool) -> None:
    """Raise RecordingError if the suffix names no format, or a file or folder of the export already exists."""
    refuse_format(path)
    made = registry.load("export_formats", path.suffix[1:])
    if not (everything and isinstance(made, StepFiles)):
        for file in (path, *others_of(path)):
            refuse_output(file, force)
        return None
    refuse_output(path.with_name(path.name + made.list_suffix), force)
    folder = _folder_of(path)
    if folder.exists() and not (force and folder.is_dir()):
        raise ExistsError(folder)


def write(path: Path, snapshots: Iterator[Snapshot], series: bool) -> tuple[Path, int]:
    """Write snapshots to a file that appears when it is complete; return its path and the number of steps.

    Several steps of `StepFiles`, such as a .vtk, go into a folder ``NAME-vtk`` beside the list of their times. Raises
    RecordingError if the file cannot be written.
    """
    numbers = itertools.count()  # at the end, the next number is the number of written steps
    counted = (snapshot for snapshot, _ in zip(snapshots, numbers, strict=False))
    made = registry.load("export_formats", path.suffix[1:])
    try:
        with tempfile.TemporaryDirectory(dir=path.parent, prefix=f".{path.name}.") as folder:
            part = Path(folder) / path.name
            if isinstance(made, StepFiles) and series:
                return _write_series(path, made, counted, Path(folder)), next(numbers)
            first = next(counted)
            made.write(part, first) if isinstance(made, StepFiles) else made(part, first, counted)
            for file, final in zip((*others_of(part), part), (*others_of(path), path), strict=True):
                if file.exists():  # a run without contacts has no contact table
                    file.replace(final)
                else:
                    final.unlink(missing_ok=True)
    except OSError as error:
        raise RecordingError(f"cannot write {path}: {error.strerror or error}") from error
    return path, next(numbers)


def _folder_of(path: Path) -> Path:
    return path.with_name(f"{path.stem}-{path.suffix[1:]}")


def _write_series(path: Path, made: StepFiles, snapshots: Iterator[Snapshot], scratch: Path) -> Path:
    listed, folder = path.with_name(path.name + made.list_suffix), _folder_of(path)
    filling, files = scratch / folder.name, list[tuple[str, float]]()
    filling.mkdir()
    for snapshot in snapshots:
        name = f"{path.stem}-{len(files):06d}{path.suffix}"
        made.write(filling / name, snapshot)
        files.append((f"{folder.name}/{name}", snapshot.time))
    made.write_list(scratch / listed.name, files)
    folder.mkdir(exist_ok=True)
    for old in folder.glob(f"{path.stem}-*{path.suffix}"):
        old.unlink()
    for file in filling.iterdir():
        file.replace(folder / file.name)
    (scratch / listed.name).replace(listed)
    return listed
