"""`Table`: named columns of a data file, whatever its format."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from carom.arrays import BoolArray, FloatArray
from carom.errors import SceneError

MOST_ROWS = 50_000_000  # a run takes 1 kB a body
MOST_BYTES = 100 * MOST_ROWS  # of one column, as an array

ROOMY = 200_000_000  # bytes that any file may unpack to: 3 million bodies that are all alike
NUMBER = 8  # bytes, as which every number is kept
MOST_TIMES = 100  # larger than in its file: positions that differ are hardly compressed

STEP, BODY = "step", "body"  # columns of what `carom export` writes; with both, a file may hold several steps

_EXACT = 2**53  # whole numbers below it are floats without rounding

Raw = NDArray[Any]  # (n,) or (n, 3), with steps first if there are several


class Law(NamedTuple):
    """What moves the bodies of a simulation, as its file says; numbers are plain ones of the table."""

    constant: float  # gravitational; 0 without gravity
    softening: float
    periodic: bool  # whether its box is
    collides: bool


class Table:
    """The columns of a file; only those that are asked for are read."""

    called: str  # what messages call it
    names: Sequence[str]  # of its columns
    units: str = ""  # the length, time and mass of its numbers, such as "au, day, M_sun"; empty if it does not say
    law: Law | None = None  # None if it does not say
    notes: tuple[str, ...] = ()  # sentences on what of it is not used, or read in another way

    def read(self, names: Sequence[str], texts: Sequence[str] = ()) -> dict[str, Raw]:
        """Read columns by their names; ``texts`` are those of which a format without types makes texts."""
        raise NotImplementedError


class Arrays(Table):
    """Columns that a Python program gives as arrays, or that another package read."""

    def __init__(self, arrays: Mapping[str, Raw], called: str = "the arrays") -> None:
        self.called = called
        self.names = list(arrays)
        self._arrays = arrays

    def read(self, names: Sequence[str], texts: Sequence[str] = ()) -> dict[str, Raw]:
        """Return arrays by their names."""
        return {name: self._arrays[name] for name in names}


def refuse_many_rows(called: str, rows: int) -> None:
    """Refuse a table before anything large is allocated for it."""
    if rows > MOST_ROWS:
        raise SceneError(f"{called}: {rows} rows are too many; at most {MOST_ROWS}")


def refuse_large(called: str, column: str, size: int) -> None:
    """Refuse a column of so many bytes."""
    if size > MOST_BYTES:
        raise SceneError(f"{called}: column {column} has {size} bytes, which are too many; at most {MOST_BYTES}")


def refuse_bomb(called: str, claimed: int, stored: int) -> None:
    """Refuse a file whose columns would take far more memory than they take in it, before they are read."""
    if claimed > max(ROOMY, MOST_TIMES * stored):
        raise SceneError(f"{called}: its {stored} bytes would take {claimed} bytes of memory: it is damaged, or a bomb")


def numbers_of(called: str, column: str, raw: Raw) -> FloatArray:
    """Return a column as float64.

    Raises
    ------
    SceneError
        Naming the first row that is not a number.
    """
    if raw.dtype.kind in "fiu":
        return raw.astype(np.float64)
    if raw.dtype.kind not in "OSU":
        raise SceneError(f"{called}: column {column} holds values of type {raw.dtype}, and numbers are needed")
    for row, value in enumerate(raw.ravel().tolist()):
        try:
            float(value)
        except (TypeError, ValueError):
            raise SceneError(f"{called}: column {column}, row {row}: {_shown(value)} is not a number") from None
    return raw.astype(np.float64)


def flags_of(called: str, column: str, raw: Raw) -> BoolArray:
    """Return a column of true and false, or of 1 and 0."""
    if raw.dtype.kind == "b":
        return raw.astype(np.bool_)
    if raw.dtype.kind in "fiu":
        wrong = (raw != 0) & (raw != 1)
    else:  # objects, if a row is empty
        wrong = np.array([not isinstance(value, bool) for value in raw.tolist()])
    if wrong.any():
        row = int(np.argmax(wrong))
        raise SceneError(
            f"{called}: column {column}, row {row}: {_shown(raw.tolist()[row])} is neither true nor false (1 or 0)"
        )
    return raw.astype(np.bool_)


def texts_of(raw: Raw) -> list[str]:
    """Return a column as texts; one that is missing is empty."""
    return [_text(value) for value in raw.tolist()]


def _text(value: Any) -> str:
    if value is None or (isinstance(value, float) and math.isnan(value)):  # as pandas marks what is missing
        return ""
    if isinstance(value, float) and value.is_integer() and abs(value) < _EXACT:  # 5, as pandas stores it beside a gap
        return str(int(value))
    return value.decode("utf-8", "replace") if isinstance(value, bytes) else str(value)


def _shown(value: Any) -> str:
    return "empty, which" if value is None or value == "" else repr(value)[:60]
