"""Tables in HDF5, by h5py: datasets anywhere in the file, by their names or full paths."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from carom.errors import SceneError
from carom.install import install_extra
from carom.scene.data.formats import NUMBER, DataFormat, DataTable, Raw, refuse_bomb, refuse_large, refuse_many_rows

_MOST_DATASETS = 10_000


def open_hdf5(path: Path, called: str, snapshot: int) -> DataTable:
    """Open an HDF5 file."""
    try:
        import h5py  # noqa: PLC0415 - an extra
    except ModuleNotFoundError:
        raise SceneError(f"{called}: HDF5 needs h5py: {install_extra('hdf5')}") from None
    with h5py.File(path, "r") as file:
        names = list[str]()

        def add(name: str | bytes, node: Any) -> bool | None:
            if isinstance(name, str) and isinstance(node, h5py.Dataset) and node.ndim:  # bytes: not UTF-8
                names.append(name)
            return True if len(names) > _MOST_DATASETS else None

        file.visititems(add)  # follows no links, which could lead out of the file
    return _Datasets(path, called, names)


class _Datasets(DataTable):
    def __init__(self, path: Path, called: str, names: Sequence[str]) -> None:
        self._path = path
        self.called = called
        self.names = names

    def read(self, names: Sequence[str], texts: Sequence[str] = ()) -> dict[str, Raw]:
        """Read datasets; their shapes are checked before memory is allocated."""
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


HDF5 = DataFormat("an HDF5 file", open_hdf5)
