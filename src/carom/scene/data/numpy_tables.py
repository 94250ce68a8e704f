"""Tables in NumPy's .npz. Files are only data: pickled objects are refused."""

from __future__ import annotations

import math
import zipfile
from collections.abc import Sequence
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.lib import format as npy

from carom.errors import SceneError
from carom.scene.data.formats import DataFormat, DataTable, Raw, refuse_bomb, refuse_large, refuse_many_rows

_SUFFIX = ".npy"
_LARGEST_HEADER = 10_000  # characters


def open_npz(path: Path, called: str, snapshot: int) -> DataTable:
    """Open an archive of arrays."""
    with zipfile.ZipFile(path) as archive:
        names = [name.removesuffix(_SUFFIX) for name in archive.namelist() if name.endswith(_SUFFIX)]
    return _Archive(path, called, names)


class _Archive(DataTable):
    def __init__(self, path: Path, called: str, names: Sequence[str]) -> None:
        self._path = path
        self.called = called
        self.names = names

    def read(self, names: Sequence[str], texts: Sequence[str] = ()) -> dict[str, Raw]:
        """Read arrays, whose headers are checked before memory is allocated."""
        with zipfile.ZipFile(self._path) as archive:
            claimed = sum(archive.getinfo(name + _SUFFIX).file_size for name in names)
            refuse_bomb(self.called, claimed, self._path.stat().st_size)
            return {name: self._array(archive, name) for name in names}

    def _array(self, archive: zipfile.ZipFile, name: str) -> Raw:
        info = archive.getinfo(name + _SUFFIX)
        with archive.open(info) as member:
            shape, kind = _header(member)
            if kind.hasobject:
                raise SceneError(f"{self.called}: array {name} holds Python objects, which are not read; save numbers")
            size = math.prod(shape) * kind.itemsize
            if size != info.file_size - member.tell():
                raise SceneError(f"{self.called}: array {name} is damaged: it claims to have {size} bytes")
            refuse_many_rows(self.called, max(shape, default=0))
            refuse_large(self.called, name, size)
        with archive.open(info) as member:
            return np.asarray(npy.read_array(member, allow_pickle=False, max_header_size=_LARGEST_HEADER))


def _header(member: IO[bytes]) -> tuple[tuple[int, ...], np.dtype[Any]]:
    """Read the shape and the type in the header of an array."""
    version = npy.read_magic(member)
    if version not in ((1, 0), (2, 0)):
        raise ValueError(f"an array of version {version[0]}.{version[1]}")
    read = npy.read_array_header_1_0 if version == (1, 0) else npy.read_array_header_2_0
    shape, _, kind = read(member, max_header_size=_LARGEST_HEADER)
    return shape, kind


NPZ = DataFormat("an .npz file", open_npz)
