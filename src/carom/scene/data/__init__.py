"""Formats of data files: the interface of tables, their limits, and the formats by suffix."""

from __future__ import annotations

import contextlib
import math
import re
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from carom import registry
from carom.arrays import BoolArray, FloatArray
from carom.errors import SceneError
from carom.scene.data.facts import Facts
from carom.scene.wording import suggestion

MOST_ROWS = 50_000_000  # largest number of rows; a run needs 1 kB per body
MOST_BYTES = 100 * MOST_ROWS  # largest size of a column as an array, in bytes
MOST_COLUMNS = 10_000
ROOMY = 250_000_000  # bytes to which the columns of any file may decompress
NUMBER = 8  # bytes of a number in memory
MOST_TIMES = 12  # largest ratio of the decompressed size to the file's size; distinct positions hardly compress
# rows that any file may have; a body takes 170 bytes until it is placed, or up to 210 if it comes from a text
FREE_ROWS = 2_000_000
LEAST_ROW = 10  # bytes of the file for each further body; three coordinates in single precision take 12

_FORTRAN = re.compile(r"([+-]?\d*\.?\d*)[dD]?([+-]?\d+)")  # 1.0D-01, or 1.0-101 if the exponent has three digits
_LONGEST_NUMBER = 60  # largest number of characters of a number
_EXACT = 2**53  # floats represent whole numbers below this exactly

Raw = NDArray[Any]  # (n,) or (n, 3), with an axis of steps first if there are several


class MotionLaw(NamedTuple):
    """The law of motion of the simulation in a file. All numbers are in the units of the table."""

    constant: float  # gravitational constant of the file; 0 without gravity
    softening: float
    collides: bool
    integrated: str = ""  # integrator and step of the file's program, in words
    integrator: str = ""  # carom's integrator of the same method, if there is one
    ghosts: tuple[int, int, int] = (0, 0, 0)  # images of the file's box on each side along x, y and z


class DataTable:
    """The columns of a file; only requested columns are read."""

    called: str  # name of the file in messages
    names: Sequence[str]  # names of the columns
    hidden: Sequence[str] = ()  # names of further columns, which are read only if the scene names them
    unnamed: int = 0  # number of columns if they have no names
    paths: bool = False  # whether names are paths of HDF5, which end with the name of the column
    vectors: Collection[str] = ()  # names of the columns that hold three numbers for each body
    facts: Facts = Facts()  # units, and other statements of the file about its numbers
    law: MotionLaw | None = None  # None if unknown
    timed: bool = False  # whether the format finds a snapshot by its time
    notes: tuple[str, ...] = ()  # notes on columns that are unused or reinterpreted

    def read(self, names: Sequence[str], texts: Sequence[str] = ()) -> dict[str, Raw]:
        """Read columns by their names. A format without types reads the columns in ``texts`` as texts."""
        raise NotImplementedError

    def rename(self, names: Sequence[str]) -> None:
        """Name all columns, for a text file without a header."""
        raise SceneError(
            f"{self.called}: columns = […] names all columns of a text file, but this format has names; write columns "
            "= { position = … } for those that differ"
        )


class DataFormat(NamedTuple):
    """A format of data files, registered in `carom.registry` under the suffix of its files."""

    called: str  # name in messages of a file of this format: "an Arrow file"
    # opens the file at a path, given the name in messages and the index of a step
    open: Callable[[Path, str, int], DataTable]
    # times of the steps in a file, ascending, in the units of its numbers; None if the format states no times
    times: Callable[[Path, str], Sequence[float]] | None = None


class Arrays(DataTable):
    """Columns that a Python program gives as arrays, or that another package has read."""

    def __init__(self, arrays: Mapping[str, Raw], called: str = "the arrays") -> None:
        self.called = called
        self.names = list(arrays)
        self.vectors = [name for name, array in arrays.items() if np.shape(array)[-1:] == (3,) and np.ndim(array) > 1]
        self._arrays = arrays

    def read(self, names: Sequence[str], texts: Sequence[str] = ()) -> dict[str, Raw]:
        """Return arrays by their names."""
        return {name: self._arrays[name] for name in names}


def refuse_many_rows(called: str, rows: int, stored: int) -> None:
    """Refuse a table in a file of ``stored`` bytes before memory is allocated for the table."""
    if rows > MOST_ROWS:
        raise SceneError(f"{called}: {rows} rows are too many; at most {MOST_ROWS}")
    if rows > max(FREE_ROWS, stored // LEAST_ROW):
        raise SceneError(
            f"{called}: {rows} rows in {stored} bytes, less than {LEAST_ROW} bytes a row: the file is damaged, or a "
            f"decompression bomb; only files of up to {FREE_ROWS} rows may have so few bytes a row"
        )


def refuse_many_columns(called: str, columns: int, each: int = 1) -> None:
    """Refuse a table with more columns than any table of bodies has; each of the ``columns`` has ``each`` parts."""
    if columns > each * MOST_COLUMNS:
        raise SceneError(f"{called}: {columns} columns are too many; at most {MOST_COLUMNS}")


def refuse_large(called: str, what: str, size: int, most: int | None = None) -> None:
    """Refuse a file or a column of more than ``most`` bytes, by default `MOST_BYTES`."""
    limit = MOST_BYTES if most is None else most
    if size > limit:
        raise SceneError(f"{called}: {what} has {size} bytes, which are too many; at most {limit}")


def step_at(called: str, snapshot: int, steps: int, whose: str = "it") -> int:
    """Return the index of a snapshot, where -1 is the last; raises SceneError if there is no such snapshot."""
    if not -steps <= snapshot < steps:
        raise SceneError(f"{called}: there is no snapshot {snapshot}: {whose} has {steps}")
    return snapshot % steps


def refuse_bomb(called: str, claimed: int, stored: int) -> None:
    """Refuse a file whose columns would take far more memory than the file, before they are read."""
    if claimed > max(ROOMY, MOST_TIMES * stored):
        raise SceneError(
            f"{called}: its {stored} bytes would take {claimed} bytes of memory: it is damaged, or a decompression bomb"
        )


def numbers_of(called: str, column: str, raw: Raw, with_gaps: bool = False) -> FloatArray:
    """Return a column as float64; with gaps allowed, missing values are NaN.

    Raises SceneError, which names the first row that is not a number.
    """
    if raw.dtype.kind in "fiu":
        return raw.astype(np.float64)
    if raw.dtype.kind not in "OSU":
        raise SceneError(f"{called}: column {column} holds values of type {raw.dtype} instead of numbers")
    numbers = np.empty(raw.size)
    for row, value in enumerate(raw.ravel().tolist()):
        number = math.nan if with_gaps and value in (None, "", b"") else number_in(value)
        if number is None:
            raise SceneError(f"{called}: column {column}, row {row}: {_shown(value)} is not a number")
        numbers[row] = number
    return numbers.reshape(raw.shape)


def number_in(value: Any) -> float | None:
    """Return a value as a number, even in Fortran's form (1.0D-01); None if it is not a number."""
    try:
        return float(value)
    except (TypeError, ValueError):
        text = value.decode("utf-8", "replace") if isinstance(value, bytes) else str(value)
    fortran = _FORTRAN.fullmatch(text.strip()) if len(text) <= _LONGEST_NUMBER else None
    try:
        return float(f"{fortran[1]}E{fortran[2]}") if fortran else None
    except ValueError:
        return None


_FLAGS = {**dict.fromkeys(("true", "t", "yes", "y", "1"), True), **dict.fromkeys(("false", "f", "no", "n", "0"), False)}


def flags_of(called: str, column: str, raw: Raw) -> BoolArray:
    """Return a column of booleans, written as true and false, yes and no, or 1 and 0."""
    if raw.dtype.kind == "b":
        return raw.astype(np.bool_)
    if raw.dtype.kind in "fiu" and np.isin(raw, (0, 1)).all():
        return raw.astype(np.bool_)
    flags = np.zeros(raw.shape, np.bool_)
    for row, value in enumerate(raw.tolist()):
        text = value.decode("utf-8", "replace") if isinstance(value, bytes) else value
        known = bool(text) if text in (0, 1) else _FLAGS.get(str(text).strip().lower())
        if known is None:
            raise SceneError(
                f"{called}: column {column}, row {row}: {_shown(value)} is neither true nor false (yes or no, 1 or 0)"
            )
        flags[row] = known
    return flags


def texts_of(raw: Raw) -> list[str]:
    """Return a column as texts; missing texts are empty."""
    return [_text(value).strip() for value in raw.tolist()]


def _text(value: Any) -> str:
    if value is None or (isinstance(value, float) and math.isnan(value)):  # pandas' mark for a missing value
        return ""
    # pandas reads 5 as 5.0 in a column with a gap
    if isinstance(value, float) and value.is_integer() and abs(value) < _EXACT:
        return str(int(value))
    return value.decode("utf-8", "replace") if isinstance(value, bytes) else str(value)


def _shown(value: Any) -> str:
    return "empty, which" if value is None or value == "" else repr(value)[:60]


_CONVERTED = {  # formats of point clouds and meshes, which have no radii or masses of bodies
    ".ply": "open it in ParaView, and save its points as .vtp or .csv",
    ".pcd": "write it as .xyz, a row of x y z for each point, with pcl_convert or Open3D",
}
_ROUNDED = 1e-8  # relative error of a time that was printed and typed again
_LONGEST_REASON = 200  # largest number of characters of a library's message


def open_table(
    path: Path, called: str, snapshot: int, header: Sequence[str] | None = None, time: float | None = None
) -> DataTable:
    """Open a data file, whose suffix names its format.

    The snapshot has the index ``snapshot``; with ``time``, in the units of the scene, it is the nearest snapshot.
    ``called`` is the name of the file in messages, and ``header`` has the names of all columns of a text file, if the
    scene states them. Raises SceneError if the format is unknown, its package is missing, or the file is not of this
    format.
    """
    ending = path.suffix.lower()
    known = [f".{name}" for name in registry.names("data_formats")]
    if ending not in known:
        remedy = _CONVERTED.get(ending) or suggestion(path.suffix, known)
        raise SceneError(f'{called}: no format has the suffix "{path.suffix}"; {remedy}')
    form: DataFormat = registry.load("data_formats", ending[1:])
    with _reading(called, form):
        # only if a time is requested, since otherwise a column of the table may contain times
        if time is not None and form.times is not None:
            times = np.asarray(form.times(path, called), dtype=np.float64)
            rounding = _ROUNDED * float(np.abs(times).max())
            if not times.min() - rounding <= time <= times.max() + rounding:
                raise SceneError(
                    f"{called}: snapshot_time = {time:g} is outside of its {len(times)} snapshots, from "
                    f"t = {times.min():g} to {times.max():g}"
                )
            snapshot = int(np.argmin(np.abs(times - time)))
        table = form.open(path, called, snapshot)
        if header is not None:
            table.rename(header)
        if table.unnamed:
            raise SceneError(
                f"{called}: no line names its {table.unnamed} columns; name them all, such as "
                'columns = ["x", "y", "z", "radius", …]'
            )
        refuse_many_columns(called, len(table.names))
        return _Guarded(table, form)


class _Guarded(DataTable):
    """A table that raises only `SceneError`."""

    def __init__(self, table: DataTable, form: DataFormat) -> None:
        self._table = table
        self._form = form
        self.called, self.names, self.hidden, self.paths = table.called, table.names, table.hidden, table.paths
        self.vectors, self.facts, self.law, self.notes = table.vectors, table.facts, table.law, table.notes
        self.timed = form.times is not None

    def read(self, names: Sequence[str], texts: Sequence[str] = ()) -> dict[str, Raw]:
        """Read columns by their names."""
        with _reading(self.called, self._form):
            return self._table.read(names, texts)


@contextlib.contextmanager
def _reading(called: str, form: DataFormat) -> Iterator[None]:
    """Convert an exception of a library, for example about a damaged file, to one sentence."""
    try:
        yield
    except SceneError:
        raise
    except MemoryError:
        raise SceneError(f"{called}: too large for the memory of this machine") from None
    except Exception as error:
        reason = (str(error).strip().splitlines() or [type(error).__name__])[0][:_LONGEST_REASON]
        raise SceneError(f"{called}: not {form.called}, or damaged: {reason}") from None
