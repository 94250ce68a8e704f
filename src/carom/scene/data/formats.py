"""Formats of data files, by the endings of their names."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from pathlib import Path

from carom.scene.data.table import Table
from carom.scene.error import SceneError
from carom.scene.nearest import suggestion

_OPENERS = {  # module and function; each module is imported when a file of its format is opened
    ".csv": ("arrow_tables", "open_csv"),
    ".tsv": ("arrow_tables", "open_csv"),
    ".parquet": ("arrow_tables", "open_parquet"),
    ".arrow": ("arrow_tables", "open_arrow"),
    ".feather": ("arrow_tables", "open_arrow"),
    ".npz": ("numpy_tables", "open_npz"),
    ".h5": ("hdf5_tables", "open_hdf5"),
    ".hdf5": ("hdf5_tables", "open_hdf5"),
    ".bin": ("rebound_tables", "open_rebound"),
    ".rebound": ("rebound_tables", "open_rebound"),
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
    if path.suffix.lower() not in _OPENERS:
        raise SceneError(f'{called}: no format has the ending "{path.suffix}"; {suggestion(path.suffix, _OPENERS)}')
    module, function = _OPENERS[path.suffix.lower()]
    opener: Callable[[Path, str, int], Table] = getattr(import_module(f"{__package__}.{module}"), function)
    return opener(path, called, snapshot)
