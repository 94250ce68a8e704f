"""Legacy VTK files, which ParaView and VisIt open: points with scalars and vectors (VTK File Formats, Kitware)."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from urllib.parse import quote

import numpy as np

from carom.arrays import FloatArray, Int32Array
from carom.recording.export import Snapshot, StepFiles


def _write(path: Path, snapshot: Snapshot) -> None:
    """Write one step; in ParaView, draw it as Point Gaussians or with the filter Glyph, scaled by ``radius``.

    Contacts of two bodies are lines, and their data are cell data: the filter Tube, scaled by ``normal_force``, shows
    force chains. The cells of bodies have zeros, so that a threshold on ``is_contact`` separates bodies from contacts.
    """
    n = len(snapshot)
    pairs, measured = _contacts(snapshot)
    lines = np.concatenate((np.full((len(pairs), 1), 2, np.int32), pairs), axis=1).astype(np.int32)
    vertices = np.stack((np.ones(n, np.int32), np.arange(n, dtype=np.int32)), axis=1)
    with path.open("wb") as file:
        file.write(b"# vtk DataFile Version 3.0\ncarom, in m, s, kg, rad, N, J\nBINARY\nDATASET POLYDATA\n")
        file.write(b"FIELD FieldData 2\nTIME 1 1 double\n" + _bytes(np.array([snapshot.time])))
        file.write(b"CYCLE 1 1 int\n" + _bytes(np.array([snapshot.step], np.int32)))
        file.write(f"POINTS {n} double\n".encode() + _bytes(snapshot.vectors["position"]))
        file.write(f"VERTICES {n} {2 * n}\n".encode() + _bytes(vertices))
        if len(pairs):  # readers refuse an empty list of cells
            file.write(f"LINES {len(pairs)} {3 * len(pairs)}\n".encode() + _bytes(lines))
        file.write(f"CELL_DATA {n + len(pairs)}\nFIELD FieldData {len(measured) + 1}\n".encode())
        is_contact = np.concatenate((np.zeros(n, np.int32), np.ones(len(pairs), np.int32)))
        file.write(f"is_contact 1 {n + len(pairs)} int\n".encode() + _bytes(is_contact))
        for name, values in measured.items():
            of_cells = np.concatenate((np.zeros(n), values))
            file.write(f"{name} 1 {n + len(pairs)} double\n".encode() + _bytes(of_cells))
        file.write(f"POINT_DATA {n}\n".encode())
        arrays = {"mass": snapshot.mass, "radius": snapshot.radius, **snapshot.vectors}
        del arrays["position"]
        names = snapshot.others.get("name")
        fields = len(arrays) + (1 if names is None else 2)
        # a FIELD, since readers ignore all SCALARS and VECTORS but the first
        file.write(f"FIELD FieldData {fields}\n".encode())
        file.write(f"body 1 {n} int\n".encode() + _bytes(snapshot.body.astype(np.int32)))
        if names is not None:
            texts = "".join(f"{quote(str(name), safe=' ')}\n" for name in names)  # VTK decodes %xx, so names are quoted
            file.write(f"name 1 {n} string\n{texts}".encode())
        for name, values in arrays.items():
            file.write(f"{name} {1 if values.ndim == 1 else values.shape[1]} {n} double\n".encode() + _bytes(values))


_OF_CONTACTS = ("normal_force", "tangential_force", "normal_impulse", "tangential_impulse", "energy_lost")


def _contacts(snapshot: Snapshot) -> tuple[Int32Array, dict[str, FloatArray]]:
    """Return the points that contacts of two bodies join, (m, 2), and the measured values; unknown values are 0."""
    table = snapshot.contacts
    if table is None:
        return np.zeros((0, 2), np.int32), {name: np.zeros(0) for name in _OF_CONTACTS}
    ends = np.stack([table[end].to_numpy() for end in "ij"], axis=1)
    own = np.isin(ends, snapshot.body).all(axis=1)
    points = np.searchsorted(snapshot.body, ends[own]).astype(np.int32)
    return points, {name: np.nan_to_num(table[name].to_numpy()[own].astype(np.float64)) for name in _OF_CONTACTS}


def _write_list(path: Path, files: Sequence[tuple[str, float]]) -> None:
    """Write the list of files and times that ParaView opens."""
    listed = [{"name": name, "time": time} for name, time in files]
    path.write_text(json.dumps({"file-series-version": "1.0", "files": listed}, indent=1), encoding="utf-8")


def _bytes(values: FloatArray | Int32Array) -> bytes:
    """Return values in VTK's byte order, most significant byte first."""
    return values.astype(values.dtype.newbyteorder(">")).tobytes() + b"\n"


VTK = StepFiles(_write, _write_list, ".series")
