"""Binary files of arrays: HDF5, NumPy's .npz, and GSD of HOOMD-blue.

The packages h5py and gsd read HDF5 and GSD. A scene names a dataset of HDF5 by its name or its full path; snapshots of
Gadget and sets of AMUSE are recognised. Pickled objects in an .npz are refused.
"""

from __future__ import annotations

import contextlib
import json
import math
import re
import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.lib import format as npy

from carom.arrays import FloatArray
from carom.errors import SceneError, install_extra
from carom.scene.data import (
    NUMBER,
    Arrays,
    DataFormat,
    DataTable,
    Raw,
    refuse_bomb,
    refuse_large,
    refuse_many_rows,
    step_at,
)
from carom.scene.data.facts import Facts, FileBox
from carom.scene.units.system import UnitSystem

_MOST_DATASETS = 10_000
_MOST_NODES = 20_000  # largest number of groups and datasets; looking through them takes half a second
_LONGEST_PATH = 1000  # largest number of characters of a path; HDF5's time grows as the square of the depth
_HEADER = "Header"  # name of a group in the snapshots of Gadget, AREPO, GIZMO and SWIFT
_OF_TYPE = re.compile(r"PartType(\d)/(\w+)")
_MASSES = "Masses"
# attributes that state units in files of AMUSE, unyt, pint, PyTables and H5MD
_UNIT_KEYS = ("units", "unit", "Units", "Unit", "UNITS")
_OF_AMUSE = {"length": "m", "time": "s", "mass": "kg"}  # base units in texts of AMUSE's files
_OF_AMUSE_SET = re.compile(r"particles/\d{10}/")
_OF_UNITS = ("Parameters", "Units")  # groups in which Gadget-4 and SWIFT state units
_SIZES = {  # key of [units] → unit, and attributes of Gadget and AREPO, GIZMO, SWIFT
    "length": ("cm", ("UnitLength_in_cm", "UnitLength_In_CGS", "Unit length in cgs (U_L)")),
    "mass": ("g", ("UnitMass_in_g", "UnitMass_In_CGS", "Unit mass in cgs (U_M)")),
    "velocity": ("cm/s", ("UnitVelocity_in_cm_per_s", "UnitVelocity_In_CGS")),
    "time": ("s", ("Unit time in cgs (U_t)",)),
}
_OF_GAS = ("Density",)  # columns that describe the gas around a particle, not a sphere
_SUFFIX = ".npy"
_LARGEST_HEADER = 10_000  # largest number of characters of a header


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
            if isinstance(name, str) and isinstance(node, h5py.Dataset) and node.ndim:  # a name in bytes is not UTF-8
                names.append(name)
            return True if len(names) > _MOST_DATASETS else None

        file.visititems(add)  # this ignores links, which could lead out of the file
        of_columns, vectors = dict[str, str](), list[str]()
        for name in names:
            shape, attributes = file[name].shape, file[name].attrs
            if len(shape) > 1 and shape[-1] == 3:
                vectors.append(name)
            if key := next((each for each in _UNIT_KEYS if each in attributes), ""):
                of_columns[name] = _text_of(attributes[key])
        if _HEADER in file and "NumPart_ThisFile" in file[_HEADER].attrs:
            stated = {key: file[group].attrs[key] for group in _OF_UNITS if group in file for key in file[group].attrs}
            return _Snapshot(path, called, names, stated | dict(file[_HEADER].attrs), of_columns)
    sets = sorted({found[0] for name in names if (found := _OF_AMUSE_SET.match(name))})
    chosen = sets[step_at(called, snapshot, len(sets))] if len(sets) > 1 else ""
    table = _Datasets(path, called, [name for name in names if name.startswith(chosen)], vectors)
    table.facts = Facts(of_columns=of_columns)
    if chosen:  # each save by AMUSE appends a set
        table.hidden = [name for name in names if not name.startswith(chosen)]
        table.notes = (f"{called}: {chosen.rstrip('/')} is read, set {sets.index(chosen)} of {len(sets)} (from 0)",)
    return table


def _text_of(value: Any) -> str:
    """Return the text of an attribute, whose type depends on the program."""
    one = np.ravel(value)[0] if np.size(value) == 1 else ""
    text = one.decode("utf-8", "replace") if isinstance(one, bytes) else str(one)
    if "system.get(" not in text:
        return text
    for kind, name in _OF_AMUSE.items():
        text = text.replace(f"system.get('S.I.').base('{kind}')", name)
    # products of powers of base units, such as "(31556925.9936 * s)" and "(m * (s**-1))"
    return text if ")**" in text else re.sub(r"^([\d.eE+-]+) \* ", r"\1 ", re.sub("[()]", "", text))


class _NamedArrays(DataTable):
    """Arrays of a file, by their names."""

    def __init__(self, path: Path, called: str, names: Sequence[str], vectors: Sequence[str] = ()) -> None:
        self._path = path
        self.called = called
        self.names, self.vectors = names, vectors


class _Datasets(_NamedArrays):
    """Datasets of a file, by their full paths."""

    paths = True

    def read(self, names: Sequence[str], texts: Sequence[str] = ()) -> dict[str, Raw]:
        """Read datasets; their shapes are checked before memory is allocated."""
        import h5py  # noqa: PLC0415 - an extra

        with h5py.File(self._path, "r") as file:
            datasets = {name: file[name] for name in names}
            claimed = sum(_most_values(each) * max(each.dtype.itemsize, NUMBER) for each in datasets.values())
            refuse_bomb(self.called, claimed, self._path.stat().st_size)
            return {name: self._array(name, dataset) for name, dataset in datasets.items()}

    def _array(self, name: str, dataset: Any) -> Raw:
        if dataset.external or dataset.is_virtual:
            raise SceneError(f"{self.called}: dataset {name} is stored in another file, which is not read")
        refuse_many_rows(self.called, max(dataset.shape, default=0), self._path.stat().st_size)
        refuse_large(self.called, f"column {name}", _most_values(dataset) * dataset.dtype.itemsize)
        return np.asarray(dataset[()])


def _most_values(dataset: Any) -> int:
    """Return the number of values that HDF5 unpacks at a time: the dataset, or a chunk, which may be far larger."""
    return max(int(math.prod(dataset.shape)), int(math.prod(dataset.chunks or ())))


class _Snapshot(_Datasets):
    """A snapshot of Gadget: the particles of all types, one type after another.

    A dataset that every type has becomes one column. The mass of a type is in the header's table, or in a dataset.
    """

    def __init__(
        self, path: Path, called: str, names: Sequence[str], header: Mapping[str, Any], of_columns: Mapping[str, str]
    ) -> None:
        super().__init__(path, called, names)
        self.hidden = names
        files = int(np.max(header.get("NumFilesPerSnapshot", 1)))
        if files > 1:
            raise SceneError(
                f"{called}: one of the {files} files of a snapshot; join them, or write the snapshot to one file"
            )
        counts = [int(count) for count in np.ravel(header["NumPart_ThisFile"])]
        refuse_many_rows(called, sum(counts), path.stat().st_size)
        masses = [float(mass) for mass in np.ravel(header.get("MassTable", 0.0))]
        masses += [0.0] * (len(counts) - len(masses))
        self._counts = {kind: count for kind, count in enumerate(counts) if count > 0}
        self._masses = {kind: mass for kind, mass in enumerate(masses) if mass > 0.0}
        of_type: dict[int, list[str]] = {kind: [] for kind in self._counts}
        for match in filter(None, map(_OF_TYPE.fullmatch, names)):
            if int(match[1]) in of_type:
                of_type[int(match[1])].append(match[2])
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
        box = np.ravel(header.get("BoxSize", 0.0)).astype(float)
        has_box = len(box) in (1, 3) and float(box.max()) > 0.0
        if float(np.max(header.get("Omega0", 0.0))) > 0.0:
            notes.append(
                f"{called}: Omega0 is above 0, so its lengths are comoving and its velocities contain Gadget's factor "
                "√a; its numbers are used unchanged"
            )
        units = _units_of_gadget(header)
        self.facts = Facts(
            units=UnitSystem(units),
            of_columns={**of_columns}
            | {path.split("/", 1)[1]: text for path, text in of_columns.items() if "/" in path},
            time=float(np.max(header["Time"])) if "Time" in header else None,
            box=FileBox((0.0, 0.0, 0.0), tuple(np.broadcast_to(box, 3).tolist()), "xyz") if has_box else None,
        )
        if units:
            notes.append(f"{called}: its units are {', '.join(units.values())}")
        self.notes = tuple(notes)

    def read(self, names: Sequence[str], texts: Sequence[str] = ()) -> dict[str, Raw]:
        """Read datasets, and columns that join the particles of all types."""
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


def _units_of_gadget(header: Mapping[str, Any]) -> dict[str, str]:
    """Return the units that a header states, by the keys of [units].

    Gadget, AREPO and GIZMO count lengths and masses in 1/h of UnitLength_in_cm and UnitMass_in_g, with h in HubbleParam
    (Springel, User guide for GADGET-2, section 5.2: "the internal length unit in cm/h"; Hopkins, load_from_snapshot.py
    of GIZMO, multiplies Coordinates and Masses by 1/h, but not Velocities).
    """
    h = float(np.max(header.get("HubbleParam", 1.0))) or 1.0
    found = dict[str, str]()
    for key, (unit, names) in _SIZES.items():
        if name := next((each for each in names if each in header), ""):
            size = float(np.max(header[name])) / (h if key != "velocity" and not name.startswith("Unit ") else 1.0)
            found[key] = f"{size!r} {unit}"
    return found


HDF5 = DataFormat("an HDF5 file", open_hdf5)


def open_npz(path: Path, called: str, snapshot: int) -> DataTable:
    """Open an archive of arrays."""
    with zipfile.ZipFile(path) as archive:
        names = [name.removesuffix(_SUFFIX) for name in archive.namelist() if name.endswith(_SUFFIX)]
        vectors = list[str]()
        for name in names:
            with archive.open(name + _SUFFIX) as member, contextlib.suppress(ValueError):
                shape = _header_of(member)[0]
                vectors += [name] if len(shape) > 1 and shape[-1] == 3 else []
    return _Archive(path, called, names, vectors)


def _header_of(member: IO[bytes]) -> tuple[tuple[int, ...], np.dtype[Any]]:
    """Read the shape and the type of an array."""
    version = npy.read_magic(member)
    if version not in ((1, 0), (2, 0)):
        raise ValueError(f"an array of version {version[0]}.{version[1]}")
    read = npy.read_array_header_1_0 if version == (1, 0) else npy.read_array_header_2_0
    shape, _, kind = read(member, max_header_size=_LARGEST_HEADER)
    return shape, kind


class _Archive(_NamedArrays):
    """Arrays of an archive."""

    def read(self, names: Sequence[str], texts: Sequence[str] = ()) -> dict[str, Raw]:
        """Read arrays; their headers are checked before memory is allocated."""
        with zipfile.ZipFile(self._path) as archive:
            claimed = sum(archive.getinfo(name + _SUFFIX).file_size for name in names)
            refuse_bomb(self.called, claimed, self._path.stat().st_size)
            return {name: self._array(archive, name) for name in names}

    def _array(self, archive: zipfile.ZipFile, name: str) -> Raw:
        info = archive.getinfo(name + _SUFFIX)
        with archive.open(info) as member:
            shape, kind = _header_of(member)
            if kind.hasobject:
                raise SceneError(f"{self.called}: array {name} holds Python objects, which are not read; save numbers")
            size = math.prod(shape) * kind.itemsize
            if size != info.file_size - member.tell():
                raise SceneError(f"{self.called}: array {name} is damaged: it claims to have {size} bytes")
            refuse_many_rows(self.called, max(shape, default=0), self._path.stat().st_size)
            refuse_large(self.called, f"column {name}", size)
        with archive.open(info) as member:
            return np.asarray(npy.read_array(member, allow_pickle=False, max_header_size=_LARGEST_HEADER))


NPZ = DataFormat("an .npz file", open_npz)


_CHUNKS = ("position", "velocity", "mass", "diameter", "angmom", "moment_inertia", "typeid", "charge", "orientation")


def open_gsd(path: Path, called: str, snapshot: int) -> DataTable:
    """Open a GSD file at one of its frames.

    HOOMD omits data that equal the data of the first frame, and masses and diameters of 1, which are its defaults; a
    scene must state these.
    """
    try:
        from gsd import fl  # noqa: PLC0415 - an extra
    except ModuleNotFoundError:
        raise SceneError(f"{called}: GSD needs gsd: {install_extra('gsd')}") from None
    with fl.open(str(path), "r") as file:
        frames = int(file.nframes)
        if file.schema != "hoomd":
            raise SceneError(f'{called}: a GSD file of the schema "{file.schema[:40]}"; "hoomd" is needed')
        frame = step_at(called, snapshot, frames)

        def chunk(name: str, frames: Sequence[int] = (frame, 0)) -> Any:
            which = next((each for each in frames if file.chunk_exists(each, name)), None)
            return None if which is None else np.asarray(file.read_chunk(which, name))

        count = chunk("particles/N")
        if count is None:
            raise SceneError(f"{called}: frame {frame} has no particles")
        refuse_many_rows(called, int(count[0]), path.stat().st_size)
        # data that a frame omits equal the data of the first frame, or have their default if the numbers of particles
        # differ
        first = chunk("particles/N", (0,))
        known = (frame, 0) if first is not None and int(first[0]) == int(count[0]) else (frame,)
        arrays: dict[str, Raw] = {
            name: values for name in _CHUNKS if (values := chunk(f"particles/{name}", known)) is not None
        }
        shapes, box, step = chunk("particles/type_shapes"), chunk("configuration/box"), chunk("configuration/step")
    if shapes is not None and "diameter" not in arrays:
        kinds = arrays.get("typeid", np.zeros(int(count[0]), np.int64))
        diameters = _diameters_of(shapes, kinds)
        arrays |= {} if diameters is None else {"diameter": diameters}
    table = Arrays(arrays, called)
    table.notes = (
        f"{called}: frame {frame} of HOOMD, step {0 if step is None else int(step[0])}, in single precision",
    )
    if box is not None:  # HOOMD's box is about the origin, and periodic
        size = tuple(box[:3].astype(float).tolist())
        table.facts = Facts(box=FileBox(tuple(-0.5 * each for each in size), size, "xyz" if size[2] else "xy"))
    return table


def _diameters_of(shapes: Raw, kinds: Raw) -> FloatArray | None:
    """Return the diameters of spheres from the shapes of their types, a JSON text per row; None for other shapes."""
    try:
        texts = [bytes(row.astype(np.uint8)).rstrip(b"\0") for row in shapes]
        of_type = [json.loads(text) if text else {} for text in texts]
        return np.array([float(of_type[kind]["diameter"]) for kind in kinds.tolist()])
    except (ValueError, LookupError, TypeError, AttributeError):
        return None


GSD = DataFormat("a GSD file", open_gsd)
