"""Points with data in VTK's files: legacy .vtk, and the XML forms .vtp and .vtu (VTK File Formats, Kitware).

LIGGGHTS, ParaView and `carom export` write legacy files; ParaView also writes the XML forms. carom has its own reader,
since meshio reads neither POLYDATA nor .vtp.
"""

from __future__ import annotations

import base64
import itertools
import mmap
import re
import zlib
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree

import numpy as np

from carom.errors import SceneError
from carom.scene.data import (
    Arrays,
    DataFormat,
    DataTable,
    Raw,
    refuse_bomb,
    refuse_large,
    refuse_many_columns,
    refuse_many_rows,
)
from carom.scene.data.facts import printable

_MAGIC = b"# vtk DataFile Version"
_KINDS = {
    **{"char": "i1", "unsigned_char": "u1", "short": "i2", "unsigned_short": "u2", "int": "i4", "unsigned_int": "u4"},
    **{"long": "i8", "unsigned_long": "u8", "vtktypeint64": "i8", "vtkidtype": "i4", "float": "f4", "double": "f8"},
}
_DATASETS = ("POLYDATA", "UNSTRUCTURED_GRID")
_CELLS = ("VERTICES", "LINES", "POLYGONS", "TRIANGLE_STRIPS", "CELLS")
_LONGEST = 10_000  # largest number of characters in a line
_DIGITS = 12  # most digits in a count of values; counts in a file of `_LARGEST` bytes have fewer
_DIGITS_OF_WIDTH = 4
_MOST_FIELDS = 10_000  # largest number of arrays of a file
_APPENDED = re.compile(rb'<AppendedData\s+encoding="(raw|base64)"\s*>\s*_')
_ATTRIBUTES = {
    **{f"{sign}Int{8 * size}": f"{letter}{size}" for sign, letter in (("", "i"), ("U", "u")) for size in (1, 2, 4, 8)},
    **{"Float32": "f4", "Float64": "f8"},
}
_LARGEST = 2_000_000_000  # largest size of a file in bytes


def open_vtk(path: Path, called: str, snapshot: int) -> DataTable:
    """Open a legacy VTK file, which has one step."""
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
        if not content[: len(_MAGIC)] == _MAGIC:
            raise SceneError(f'{called}: a VTK file begins with "{_MAGIC.decode()}"')
        reader = _Reader(called, content)
        for _ in range(2):
            reader.line()  # version and title
        reader.binary = reader.line().strip().upper() == "BINARY"
        return Arrays(_arrays(reader), called)


class _Reader:
    """Reads lines and arrays from a file."""

    def __init__(self, called: str, content: mmap.mmap) -> None:
        self.called = called
        self._content = content
        self._place, self.size = 0, len(content)
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
        """Return the words of the next line that is not blank; empty at the end."""
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
        if count * (number.itemsize if self.binary else 2) > left + 1:  # no blank is needed after the last number
            raise SceneError(
                f"{self.called}: {count} values of the type {kind} are announced, but {left} bytes are left"
            )
        if self.binary:
            size = count * number.itemsize
            values = np.frombuffer(self._content[self._place : self._place + size], number)
            self._place += size
            return values.astype(number.newbyteorder("="))
        lines = iter(self.words, [])
        values = np.fromiter(itertools.islice((float(word) for words in lines for word in words), count), np.float64)
        if len(values) < count:
            raise SceneError(f"{self.called}: {len(values)} of {count} values; the file ends early")
        return values


def _arrays(reader: _Reader) -> dict[str, Raw]:
    """Read the points and the arrays of the points; ``each`` is the number of points, or of cells."""
    arrays, points, of_points, each = dict[str, Raw](), 0, False, 0

    def whole(word: str) -> int:
        if not word.isdecimal() or len(word) > _DIGITS:
            raise SceneError(f"{reader.called}: {printable(word)} is not a count of values")
        return int(word)

    def add(name: str, kind: str, width: int, rows: int) -> None:
        refuse_many_rows(reader.called, rows, reader.size)
        if kind.lower() == "string":  # names of points, one name in each line
            for _ in range(rows * width):
                reader.line()
            return
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
        elif title in ("POINT_DATA", "CELL_DATA"):  # VTK writes the data of cells first
            of_points, each = title == "POINT_DATA", whole(rest[0])
        elif title == "SCALARS":
            width = whole(rest[2]) if rest[2] else 1
            if reader.words()[:1] != ["LOOKUP_TABLE"]:
                raise SceneError(f"{reader.called}: no line LOOKUP_TABLE after SCALARS {printable(rest[0])}")
            add(rest[0], rest[1], width, each)
        elif title in ("VECTORS", "NORMALS"):
            add(rest[0], rest[1], 3, each)
        elif title == "TENSORS":
            add(rest[0], rest[1], 9, each)
        elif title == "FIELD":
            for _ in range(min(whole(rest[1]), _MOST_FIELDS)):
                field = [*reader.words(), "", "", ""]
                add(field[0], field[3], whole(field[1]), whole(field[2]))
        elif title == "METADATA":
            while reader.line().strip():
                pass
    if "points" not in arrays:
        raise SceneError(f"{reader.called}: it has no POINTS")
    return arrays


VTK = DataFormat("a VTK file", open_vtk)


class _Blocks(NamedTuple):
    """The encoding of a file's arrays."""

    called: str
    stored: int  # bytes of the file
    order: str  # byte order
    header: np.dtype[np.uint64] | np.dtype[np.uint32]
    compressed: bool
    appended: bytes
    raw: bool  # whether the appended data are raw bytes, not base64


_MOST_TAGS = 100_000


def open_vtp(path: Path, called: str, snapshot: int) -> DataTable:
    """Open a VTK XML file, which has one step."""
    stored = path.stat().st_size
    refuse_large(called, "the file", stored, _LARGEST)
    content = path.read_bytes()
    found = _APPENDED.search(content)
    text = content[: found.start()] + b"</VTKFile>" if found else content
    if b"<!" in text.replace(b"<!--", b""):
        raise SceneError(f"{called}: it declares a document type or an entity, which no VTK file needs")
    if text.count(b"<") > _MOST_TAGS:
        raise SceneError(f"{called}: more than {_MOST_TAGS} tags, which no VTK file of points needs")
    root = ElementTree.fromstring(text)
    if root.tag != "VTKFile" or root.get("type") not in ("PolyData", "UnstructuredGrid"):
        raise SceneError(
            f"{called}: a VTK file of the type {printable(str(root.get('type')))}; points are needed: PolyData"
        )
    compressor = root.get("compressor", "")
    if compressor not in ("", "vtkZLibDataCompressor"):
        raise SceneError(f"{called}: compressed by {printable(compressor)}, which is not read; write it with ZLib")
    order = "<" if root.get("byte_order", "LittleEndian") == "LittleEndian" else ">"
    header = np.dtype(f"{order}{_ATTRIBUTES.get(root.get('header_type', 'UInt32'), 'u4')}")
    blocks = _Blocks(
        *(called, stored, order, header, bool(compressor)),
        *(content[found.end() :] if found else b"", found is not None and found[1] == b"raw"),
    )
    found_pieces = [_announced(blocks, piece) for piece in root.iter("Piece") if piece.get("NumberOfPoints") != "0"]
    refuse_many_rows(called, sum(piece.rows for piece in found_pieces), stored)
    # arrays may share their data: together, they could become far larger than the file
    claimed = sum(piece.rows * each.width * each.kind.itemsize for piece in found_pieces for each in piece.arrays)
    refuse_bomb(called, claimed, stored)
    pieces = [_piece(blocks, piece) for piece in found_pieces]
    if not pieces:
        raise SceneError(f"{called}: it has no points")
    names = [name for name in pieces[0] if all(name in piece for piece in pieces)]
    arrays = {name: np.concatenate([piece[name] for piece in pieces]) for name in names}
    return Arrays(arrays, called)


class _Announced(NamedTuple):
    """An array of a piece, before its numbers are read."""

    name: str
    element: ElementTree.Element
    kind: np.dtype[np.generic]
    width: int


class _Piece(NamedTuple):
    """A piece, before its numbers are read."""

    rows: int
    arrays: list[_Announced]


def _announced(blocks: _Blocks, piece: ElementTree.Element) -> _Piece:
    """Return the arrays of the points of a piece."""
    rows = piece.get("NumberOfPoints", "")
    if not rows.isdecimal() or len(rows) > _DIGITS:
        raise SceneError(f"{blocks.called}: NumberOfPoints is {printable(rows)}, not a number")
    arrays = list[_Announced]()
    for section in ("Points", "PointData"):
        for element in piece.iterfind(f"{section}/DataArray"):
            name = "points" if section == "Points" else element.get("Name", "")
            width = element.get("NumberOfComponents", "1") or "1"
            if element.get("type") not in _ATTRIBUTES or not width.isdecimal() or len(width) > _DIGITS_OF_WIDTH:
                continue  # an array of texts
            kind = np.dtype(blocks.order + _ATTRIBUTES[element.get("type", "")])
            arrays.append(_Announced(name, element, kind, int(width)))
    return _Piece(int(rows), arrays)


def _piece(blocks: _Blocks, piece: _Piece) -> dict[str, Raw]:
    """Read the points of a piece, and their arrays."""
    arrays = dict[str, Raw]()
    for name, element, kind, width in piece.arrays:
        size = piece.rows * width
        values = _values(blocks, element, kind, size)
        if len(values) != size:
            raise SceneError(f"{blocks.called}: {printable(name)} has {len(values)} values, but {size} are needed")
        arrays[name] = values if width == 1 else values.reshape(piece.rows, width)
    if "points" not in arrays:
        raise SceneError(f"{blocks.called}: a piece has no Points")
    return arrays


def _values(blocks: _Blocks, element: ElementTree.Element, kind: np.dtype[np.generic], count: int) -> Raw:
    text = (element.text or "").strip()
    if element.get("format") == "ascii":
        number: type[float] | type[int] = float if kind.kind == "f" else int
        # one number more than announced is read, to notice if there are too many
        few = itertools.islice((number(word[0]) for word in re.finditer(r"\S+", text)), count + 1)
        return np.fromiter(few, kind.newbyteorder("="))
    place = element.get("offset", "0")
    if element.get("format") != "appended":
        data, raw = text.encode(), False
    elif place.isdecimal() and int(place) < len(blocks.appended):
        data, raw = blocks.appended[int(place) :], blocks.raw
    else:
        raise SceneError(
            f"{blocks.called}: the offset {printable(place)} is beyond the appended data; the file ends early"
        )
    content = _unpacked(blocks, data, raw, count * kind.itemsize)
    whole = len(content) - len(content) % kind.itemsize  # bytes of complete numbers, even in a truncated file
    return np.frombuffer(content[:whole], kind).astype(kind.newbyteorder("="))


def _unpacked(blocks: _Blocks, data: bytes, raw: bool, size: int) -> bytes:
    """Return the ``size`` bytes of an array; fewer if the file is damaged."""
    word = blocks.header.itemsize

    def part(begin: int, length: int) -> bytes:
        if raw:
            return data[begin : begin + length]
        return base64.b64decode(data[: -(-(begin + length) // 3) * 4])[begin : begin + length]

    def words(begin: int, count: int) -> list[int]:
        return [int(each) for each in np.frombuffer(part(begin * word, count * word), blocks.header)]

    if not blocks.compressed:
        return part(word, size) if words(0, 1) == [size] else b""
    count, _, _ = words(0, 3)
    if count > size:
        return b""
    sizes = words(3, count)
    header = (3 + count) * word
    if not raw:  # in base64, the header is encoded separately
        data, header = data[-(-header // 3) * 4 :], 0
    content = b""
    for length in sizes:
        content += zlib.decompressobj().decompress(part(header, length), size - len(content) + 1)
        header += length
    return content


VTP = DataFormat("a VTK XML file", open_vtp)
