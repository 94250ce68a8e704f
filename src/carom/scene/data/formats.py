"""Formats of data files, by the endings of their names."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Sequence
from importlib import import_module
from pathlib import Path
from typing import NamedTuple

from carom.errors import SceneError
from carom.scene.data.table import Raw, Table
from carom.scene.nearest import suggestion

_LONGEST_REASON = 200  # characters of what a library says


class _Format(NamedTuple):
    called: str
    module: str  # imported when a file of the format is opened
    opener: str


_TEXT = _Format("a table of values", "arrow_tables", "open_csv")
_ARROW = _Format("an Arrow file", "arrow_tables", "open_arrow")
_HDF5 = _Format("an HDF5 file", "hdf5_tables", "open_hdf5")
_REBOUND = _Format("a Simulationarchive of REBOUND", "rebound_tables", "open_rebound")
_FORMATS = {
    ".csv": _TEXT,
    ".tsv": _TEXT,
    ".parquet": _Format("a Parquet file", "arrow_tables", "open_parquet"),
    ".arrow": _ARROW,
    ".feather": _ARROW,
    ".npz": _Format("an .npz file", "numpy_tables", "open_npz"),
    ".h5": _HDF5,
    ".hdf5": _HDF5,
    ".bin": _REBOUND,
    ".rebound": _REBOUND,
}


def open_table(path: Path, called: str, snapshot: int) -> Table:
    """Open a data file.

    Parameters
    ----------
    path
        The file; its ending names the format.
    called
        Its name in messages.
    snapshot
        Which step, of a file of several.

    Raises
    ------
    SceneError
        If the format is unknown, a package for it is missing, or the file is not of this format.
    """
    if path.suffix.lower() not in _FORMATS:
        raise SceneError(f'{called}: no format has the ending "{path.suffix}"; {suggestion(path.suffix, _FORMATS)}')
    form = _FORMATS[path.suffix.lower()]
    opener: Callable[[Path, str, int], Table] = getattr(import_module(f"{__package__}.{form.module}"), form.opener)
    with _reading(called, form):
        return _Guarded(opener(path, called, snapshot), form)


class _Guarded(Table):
    """A table whose errors are all `SceneError`."""

    def __init__(self, table: Table, form: _Format) -> None:
        self._table = table
        self._form = form
        self.called, self.names, self.units = table.called, table.names, table.units
        self.law, self.notes = table.law, table.notes

    def read(self, names: Sequence[str], texts: Sequence[str] = ()) -> dict[str, Raw]:
        """Read columns by their names."""
        with _reading(self.called, self._form):
            return self._table.read(names, texts)


@contextlib.contextmanager
def _reading(called: str, form: _Format) -> Iterator[None]:
    """Turn whatever a library raises on a damaged file into one sentence."""
    try:
        yield
    except SceneError:
        raise
    except MemoryError:
        raise SceneError(f"{called}: too large for the memory of this machine") from None
    except Exception as error:
        reason = (str(error).strip().splitlines() or [type(error).__name__])[0][:_LONGEST_REASON]
        raise SceneError(f"{called}: not {form.called}, or damaged: {reason}") from None
