"""Files of named arrays: HDF5, read by h5py, and NumPy's .npz.

In HDF5, datasets may be anywhere in the file and are named by their names or full paths; Gadget snapshots are known. An
.npz is only data: pickled objects are refused.
"""

from __future__ import annotations

import math
import re
import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.lib import format as npy

from carom.errors import SceneError
from carom.install import install_extra
from carom.scene.data import (
    NUMBER,
    DataFormat,
    DataTable,
    Raw,
    periodic_note,
    refuse_bomb,
    refuse_large,
    refuse_many_rows,
)

_MOST_DATASETS = 10_000
_MOST_NODES = 20_000  # groups and datasets; looking through them takes half a second
_LONGEST_PATH = 1000  # characters; HDF5 takes a time that grows as the square of the depth
_HEADER = "Header"  # group in Gadget's snapshots, and in those of AREPO, GIZMO and SWIFT
_OF_TYPE = re.compile(r"PartType(\d)/\w+")
_MASSES = "Masses"
_OF_GAS = ("Density",)  # of the gas around a particle, not of a sphere
_SUFFIX = ".npy"
_LARGEST_HEADER = 10_000  # characters


def open_hdf5(path: Path, called: str, snapshot: int) -> DataTable:
    """Open an HDF5 file."""
    try:
        import h5py  # noqa: PLC0415 - an extra
    except ModuleNotFoundError:
        raise SceneError(f"{called}: HDF5 needs h5py: {install_extra('hdf5')}") from None
    with h5py.File(path, "r") as file:
        names, visited = list[str](), [0]

        def add(name: str | bytes, node: Any) -> bool | None:
            visited[0] += 1
            if visited[0] > _MOST_NODES or len(name) > _LONGEST_PATH:
                raise SceneError(f"{called}: more than {_MOST_NODES} groups and datasets, or paths too long to be read")
            if isinstance(name, str) and isinstance(node, h5py.Dataset) and node.ndim:  # bytes: not UTF-8
                names.append(name)
            return True if len(names) > _MOST_DATASETS else None

        file.visititems(add)  # ignores links, which could lead out of the file
        if _HEADER in file and "NumPart_ThisFile" in file[_HEADER].attrs:
            return _Snapshot(path, called, names, dict(file[_HEADER].attrs))
    return _Datasets(path, called, names)


class _Datasets(DataTable):
    """Datasets of a file, by their full paths."""

    def __init__(self, path: Path, called: str, names: Sequence[str]) -> None:
        self._path = path
        self.called = called
        self.names = names

    def read(self, names: Sequence[str], texts: Sequence[str] = ()) -> dict[str, Raw]:
        """Read datasets, whose shapes are checked before memory is allocated."""
        import h5py  # noqa: PLC0415 - an extra

        with h5py.File(self._path, "r") as file:
            datasets = {name: file[name] for name in names}
            claimed = sum(math.prod(each.shape) * max(each.dtype.itemsize, NUMBER) for each in datasets.values())
            refuse_bomb(self.called, claimed, self._path.stat().st_size)
            return {name: self._array(name, dataset) for name, dataset in datasets.items()}

    def _array(self, name: str, dataset: Any) -> Raw:
        if dataset.external or dataset.is_virtual:
            raise SceneError(f"{self.called}: dataset {name} is stored in another file, which is not read")
        refuse_many_rows(self.called, max(dataset.shape, default=0))
        refuse_large(self.called, name, math.prod(dataset.shape) * dataset.dtype.itemsize)
        return np.asarray(dataset[()])


class _Snapshot(_Datasets):
    """A snapshot of Gadget: the particles of all types, one type after another.

    A dataset that every type has becomes one column. The mass of a type is in the header's table, or in a dataset.
    """

    def __init__(self, path: Path, called: str, names: Sequence[str], header: Mapping[str, Any]) -> None:
        super().__init__(path, called, names)
        self.hidden = names
        files = int(np.max(header.get("NumFilesPerSnapshot", 1)))
        if files > 1:
            raise SceneError(
                f"{called}: one of the {files} files of a snapshot; join them, or write the snapshot to one file"
            )
        counts = [int(count) for count in np.ravel(header["NumPart_ThisFile"])]
        refuse_many_rows(called, sum(counts))
        masses = [float(mass) for mass in np.ravel(header.get("MassTable", 0.0))]
        masses += [0.0] * (len(counts) - len(masses))
        self._counts = {kind: count for kind, count in enumerate(counts) if count > 0}
        self._masses = {kind: mass for kind, mass in enumerate(masses) if mass > 0.0}
        of_type = {kind: [name.rsplit("/")[-1] for name in names if _type_of(name) == kind] for kind in self._counts}
        every = dict.fromkeys([*(name for each in of_type.values() for name in each), _MASSES])
        self.names = [
            name
            for name in every
            if name not in _OF_GAS
            and all(name in each or self._has_in_header(kind, name) for kind, each in of_type.items())
        ]
        types = (
            f"{count} of type {kind}" + (f" of mass {self._masses[kind]:g}" if kind in self._masses else "")
            for kind, count in self._counts.items()
        )
        notes = [f"{called}: read as a snapshot of Gadget, particles {', '.join(types)}"]
        if float(np.max(header.get("BoxSize", 0.0))) > 0.0:
            notes.append(periodic_note(called, np.ravel(header["BoxSize"]).tolist()))
        if float(np.max(header.get("Omega0", 0.0))) > 0.0:
            notes.append(
                f"{called}: Omega0 is above 0, so its lengths are comoving and its velocities contain Gadget's factor "
                "√a; its numbers are used unchanged"
            )
        self.notes = tuple(notes)

    def read(self, names: Sequence[str], texts: Sequence[str] = ()) -> dict[str, Raw]:
        """Read datasets, and columns that join all types."""
        paths = [name for name in names if "/" in name]
        columns = [name for name in names if "/" not in name]
        parts = [
            f"PartType{kind}/{name}" for name in columns for kind in self._counts if not self._has_in_header(kind, name)
        ]
        found = super().read([*paths, *parts])
        for name in columns:
            found[name] = np.concatenate(
                [
                    np.full(count, self._masses[kind])
                    if self._has_in_header(kind, name)
                    else found[f"PartType{kind}/{name}"]
                    for kind, count in self._counts.items()
                ]
            )
        return {name: found[name] for name in names}

    def _has_in_header(self, kind: int, name: str) -> bool:
        """Return whether a column of a type is in the header."""
        return name == _MASSES and kind in self._masses


def _type_of(name: str) -> int | None:
    """Return the type of particles to which a dataset belongs."""
    match = _OF_TYPE.fullmatch(name)
    return int(match[1]) if match else None


HDF5 = DataFormat("an HDF5 file", open_hdf5)


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
