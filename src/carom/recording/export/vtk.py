"""Legacy VTK files, which ParaView and VisIt open: points with scalars and vectors (VTK File Formats, Kitware)."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from carom.arrays import FloatArray, Int32Array
from carom.recording.export import Snapshot, StepFiles


def _write(path: Path, snapshot: Snapshot) -> None:
    """Write one step; in ParaView, draw it as Point Gaussians or with the filter Glyph, scaled by ``radius``."""
    n = len(snapshot)
    vertices = np.stack((np.ones(n, np.int32), np.arange(n, dtype=np.int32)), axis=1)
    with path.open("wb") as file:
        file.write(b"# vtk DataFile Version 3.0\ncarom\nBINARY\nDATASET POLYDATA\n")
        file.write(b"FIELD FieldData 2\nTIME 1 1 double\n" + _bytes(np.array([snapshot.time])))
        file.write(b"CYCLE 1 1 int\n" + _bytes(np.array([snapshot.step], np.int32)))
        file.write(f"POINTS {n} double\n".encode() + _bytes(snapshot.vectors["position"]))
        file.write(f"VERTICES {n} {2 * n}\n".encode() + _bytes(vertices))
        file.write(f"POINT_DATA {n}\n".encode())
        arrays = {"mass": snapshot.mass, "radius": snapshot.radius, **snapshot.vectors}
        del arrays["position"]
        fields = len(arrays) + 1
        file.write(f"FIELD FieldData {fields}\n".encode())  # readers ignore all but the first SCALARS and VECTORS
        file.write(f"body 1 {n} int\n".encode() + _bytes(snapshot.body.astype(np.int32)))
        for name, values in arrays.items():
            file.write(f"{name} {1 if values.ndim == 1 else values.shape[1]} {n} double\n".encode() + _bytes(values))


def _write_list(path: Path, files: Sequence[tuple[str, float]]) -> None:
    """Write the list of files and times that ParaView opens."""
    listed = [{"name": name, "time": time} for name, time in files]
    path.write_text(json.dumps({"file-series-version": "1.0", "files": listed}, indent=1), encoding="utf-8")


def _bytes(values: FloatArray | Int32Array) -> bytes:
    """Return values in VTK's byte order, most significant byte first."""
    return values.astype(values.dtype.newbyteorder(">")).tobytes() + b"\n"


VTK = StepFiles(_write, _write_list, ".series")
