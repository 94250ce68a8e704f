"""Files of fields: VTK image data for ParaView, arrays for NumPy, and a picture."""

from __future__ import annotations

import base64
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from carom.arrays import FloatArray
from carom.errors import RecordingError
from carom.lab.fields.field_arrays import Fields
from carom.lab.fields.field_picture import draw
from carom.recording.export import refuse_format
from carom.recording.write.whole_file import refuse_output, whole_file

# suffixes of components, by number of trailing axes
_COMPONENTS = {0: "", 1: "XYZ", 2: [f"{a}{b}" for a in "XYZ" for b in "XYZ"]}


def write_vti(fields: Fields, path: Path) -> None:
    """Write VTK image data in its XML format, with all fields as cell data in float64."""
    size = " ".join(f"0 {n}" for n in fields.shape)
    root = ElementTree.Element(
        "VTKFile", type="ImageData", version="1.0", byte_order="LittleEndian", header_type="UInt64"
    )
    image = ElementTree.SubElement(
        root, "ImageData", WholeExtent=size, Origin=_numbers(fields.origin), Spacing=_numbers(fields.cell)
    )
    times = ElementTree.SubElement(image, "FieldData")  # ParaView shows TimeValue as the time of the file
    for name, time in (("TimeValue", (fields.start + fields.end) / 2), ("start", fields.start), ("end", fields.end)):
        _array(times, name, np.array([time])).set("NumberOfTuples", "1")
    piece = ElementTree.SubElement(image, "Piece", Extent=size)
    data = ElementTree.SubElement(piece, "CellData", Scalars="solid_fraction", Vectors="velocity")
    for name, values in fields.arrays.items():
        parts = _COMPONENTS[values.ndim - 3]
        rows = np.moveaxis(values, [0, 1, 2], [2, 1, 0]).reshape(-1, max(1, len(parts)))  # x varies fastest
        array = _array(data, name, rows)
        if parts:
            array.set("NumberOfComponents", str(len(parts)))
            for number, part in enumerate(parts):
                array.set(f"ComponentName{number}", part)
    ElementTree.ElementTree(root).write(path, encoding="utf-8", xml_declaration=True)


def _array(parent: ElementTree.Element, name: str, values: FloatArray) -> ElementTree.Element:
    """Add an array in base64, with its length in bytes in front."""
    array = ElementTree.SubElement(parent, "DataArray", type="Float64", Name=name, format="binary")
    stored = np.ascontiguousarray(values, dtype="<f8").tobytes()
    array.text = base64.b64encode(len(stored).to_bytes(8, "little") + stored).decode()
    return array


def _numbers(values: FloatArray) -> str:
    return " ".join(repr(value) for value in values.tolist())


def write_npz(fields: Fields, path: Path) -> None:
    """Write all fields under their names, with ``origin``, ``cell``, ``start``, ``end`` and ``moments``."""
    with path.open("wb") as file:
        named: dict[str, Any] = {name: getattr(fields, name) for name in ("start", "end", "moments", "origin", "cell")}
        np.savez_compressed(file, **named, **dict[str, Any](fields.arrays))


FORMATS: Mapping[str, Callable[[Fields, Path], None]] = {
    ".vti": write_vti,
    ".npz": write_npz,
    ".png": draw,
    ".svg": draw,
}


def refuse(path: Path, force: bool) -> None:
    """Raise RecordingError if the suffix of a file is not in `FORMATS`, or the file cannot be written."""
    refuse_format(path, tuple(FORMATS))
    refuse_output(path, force)


def write(fields: Fields, path: Path) -> None:
    """Write a file, which appears only once it is complete; RecordingError if it cannot be written."""
    try:
        with whole_file(path) as part:
            FORMATS[path.suffix](fields, part)
    except OSError as error:
        raise RecordingError(f"cannot write {path}: {error.strerror or error}") from error
