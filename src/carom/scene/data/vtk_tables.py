"""Legacy VTK files of points, as LIGGGHTS, ParaView and `carom export` write them (VTK File Formats, Kitware).

carom has its own reader, since meshio reads neither POLYDATA nor .vtp.
"""

from __future__ import annotations

import mmap
from pathlib import Path

import numpy as np

from carom.errors import SceneError
from carom.scene.data.formats import Arrays, DataFormat, DataTable, Raw, refuse_many_columns, refuse_many_rows
from carom.scene.data.mapping import printable

_MAGIC = b"# vtk DataFile Version"
_KINDS = {
    **{"char": "i1", "unsigned_char": "u1", "short": "i2", "unsigned_short": "u2", "int": "i4", "unsigned_int": "u4"},
    **{"long": "i8", "unsigned_long": "u8", "vtktypeint64": "i8", "vtkidtype": "i4", "float": "f4", "double": "f8"},
}
_DATASETS = ("POLYDATA", "UNSTRUCTURED_GRID")
_CELLS = ("VERTICES", "LINES", "POLYGONS", "TRIANGLE_STRIPS", "CELLS")
_LONGEST = 10_000  # characters in a line


def open_vtk(path: Path, called: str, snapshot: int) -> DataTable:
    """Open a legacy VTK file, which has one step."""
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
        if not content[: len(_MAGIC)] == _MAGIC:
            raise SceneError(f'{called}: a VTK file begins with "{_MAGIC.decode()}"')
        reader = _Reader(called, content)
        for _ in range(2):
            reader.line()  # version and title
        reader.binary = reader.line().strip().upper() == "BINARY"
        table = Arrays(_arrays(reader), called)
    return table


class _Reader:
    """Reads lines and arrays from a file."""

    def __init__(self, called: str, content: mmap.mmap) -> None:
        self.called = called
        self._content = content
        self._place = 0
        self.binary = False

    def line(self) -> str:
        """Return the next line; empty at the end."""
        end = self._content.find(b"\n", self._place, self._place + _LONGEST)
        if end < 0:
            end = min(len(self._content), self._place + _LONGEST) - 1
        text = self._content[self._place : end + 1].decode("utf-8", "replace")
        self._place = end + 1
        return text

    def words(self) -> list[str]:
        """Return the words of the next line that has any; none at the end."""
        while self._place < len(self._content):
            if words := self.line().split():
                return words
        return []

    def array(self, kind: str, count: int) -> Raw:
        """Read numbers."""
        number = np.dtype(f">{_KINDS.get(kind.lower(), '')}" if kind.lower() in _KINDS else "V0")
        if not number.itemsize:
            raise SceneError(f"{self.called}: values of the type {printable(kind)} are not read")
        left = len(self._content) - self._place
        if count * (number.itemsize if self.binary else 2) > left + 1:  # the last number needs no blank after it
            raise SceneError(
                f"{self.called}: {count} values of the type {kind} are announced, but {left} bytes are left"
            )
        if self.binary:
            size = count * number.itemsize
            values = np.frombuffer(self._content[self._place : self._place + size], number)
            self._place += size
            return values.astype(number.newbyteorder("="))
        texts = list[str]()
        while len(texts) < count:
            words = self.words()
            if not words:
                raise SceneError(f"{self.called}: {len(texts)} of {count} values; the file ends early")
            texts += words
        return np.array(texts[:count], np.float64)


def _arrays(reader: _Reader) -> dict[str, Raw]:
    """Read the points and the arrays of the points."""
    arrays, points, of_points = dict[str, Raw](), 0, False

    def whole(word: str) -> int:
        if not word.isdecimal() or len(word) > 12:
            raise SceneError(f"{reader.called}: {printable(word)} is not a number of values")
        return int(word)

    def add(name: str, kind: str, width: int, rows: int) -> None:
        refuse_many_rows(reader.called, rows)
        values = reader.array(kind, rows * width)
        if of_points or name == "points":
            if rows != points:
                raise SceneError(f"{reader.called}: {printable(name)} has {rows} rows, but there are {points} points")
            arrays[name] = values if width == 1 else values.reshape(rows, width)
            refuse_many_columns(reader.called, len(arrays))

    while words := reader.words():
        title, rest = words[0].upper(), [*words[1:], "", "", ""]
        if title == "DATASET" and rest[0].upper() not in _DATASETS:
            raise SceneError(f"{reader.called}: a dataset {printable(rest[0])}; points are needed: POLYDATA")
        if title == "POINTS":
            points = whole(rest[0])
            add("points", rest[1], 3, points)
        elif title in _CELLS:
            reader.array("int", whole(rest[1]))
        elif title == "CELL_TYPES":
            reader.array("int", whole(rest[0]))
        elif title in ("OFFSETS", "CONNECTIVITY"):
            raise SceneError(
                f"{reader.called}: cells in the form of VTK 5 are not read; save it as version 4.2, or .vtp"
            )
        elif title == "POINT_DATA":
            of_points = True
        elif title == "CELL_DATA":
            break
        elif title == "SCALARS":
            width = whole(rest[2]) if rest[2] else 1
            if reader.words()[:1] != ["LOOKUP_TABLE"]:
                raise SceneError(f"{reader.called}: no line LOOKUP_TABLE after SCALARS {printable(rest[0])}")
            add(rest[0], rest[1], width, points)
        elif title in ("VECTORS", "NORMALS"):
            add(rest[0], rest[1], 3, points)
        elif title == "TENSORS":
            add(rest[0], rest[1], 9, points)
        elif title == "FIELD":
            for _ in range(min(whole(rest[1]), 10_000)):
                field = [*reader.words(), "", "", ""]
                add(field[0], field[3], whole(field[1]), whole(field[2]))
        elif title == "METADATA":
            while reader.line().strip():
                pass
    if "points" not in arrays:
        raise SceneError(f"{reader.called}: it has no POINTS")
    return arrays


VTK = DataFormat("a VTK file", open_vtk)
