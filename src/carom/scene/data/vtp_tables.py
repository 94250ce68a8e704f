"""Points with data in VTK's XML form, as ParaView writes them: .vtp and .vtu (VTK File Formats, Kitware)."""

from __future__ import annotations

import base64
import re
import zlib
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree

import numpy as np

from carom.errors import SceneError
from carom.scene.data.formats import Arrays, DataFormat, DataTable, Raw, refuse_bomb, refuse_large, refuse_many_rows
from carom.scene.data.mapping import printable

_APPENDED = re.compile(rb'<AppendedData\s+encoding="(raw|base64)"\s*>\s*_')
_KINDS = {
    **{f"{sign}Int{8 * size}": f"{letter}{size}" for sign, letter in (("", "i"), ("U", "u")) for size in (1, 2, 4, 8)},
    **{"Float32": "f4", "Float64": "f8"},
}
_LARGEST = 2_000_000_000  # bytes


class _Blocks(NamedTuple):
    """The encoding of a file's arrays."""

    called: str
    stored: int  # size of the file in bytes
    order: str  # byte order
    header: np.dtype[np.uint64] | np.dtype[np.uint32]
    compressed: bool
    appended: bytes
    raw: bool  # whether the appended data are not in base64


_MOST_TAGS = 100_000


def open_vtp(path: Path, called: str, snapshot: int) -> DataTable:
    """Open a VTK XML file, which has one step."""
    stored = path.stat().st_size
    if stored > _LARGEST:
        refuse_large(called, "file", stored)
    content = path.read_bytes()
    found = _APPENDED.search(content)
    text = content[: found.start()] + b"</VTKFile>" if found else content
    if b"<!" in text.replace(b"<!--", b""):
        raise SceneError(f"{called}: a document type or an entity in it, which no VTK file needs")
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
    header = np.dtype(f"{order}{_KINDS.get(root.get('header_type', 'UInt32'), 'u4')}")
    blocks = _Blocks(
        *(called, stored, order, header, bool(compressor)),
        *(content[found.end() :] if found else b"", found is not None and found[1] == b"raw"),
    )
    pieces = [_piece(blocks, piece) for piece in root.iter("Piece") if piece.get("NumberOfPoints") != "0"]
    if not pieces:
        raise SceneError(f"{called}: it has no points")
    names = [name for name in pieces[0] if all(name in piece for piece in pieces)]
    arrays = {name: np.concatenate([piece[name] for piece in pieces]) for name in names}
    return Arrays(arrays, called)


def _piece(blocks: _Blocks, piece: ElementTree.Element) -> dict[str, Raw]:
    """Read the points of a piece, and their arrays."""
    rows = piece.get("NumberOfPoints", "")
    if not rows.isdecimal() or len(rows) > 12:
        raise SceneError(f"{blocks.called}: NumberOfPoints is {printable(rows)}, not a number")
    refuse_many_rows(blocks.called, int(rows))
    arrays = dict[str, Raw]()
    for section in ("Points", "PointData"):
        for element in piece.iterfind(f"{section}/DataArray"):
            name = "points" if section == "Points" else element.get("Name", "")
            width = element.get("NumberOfComponents", "1") or "1"
            if element.get("type") not in _KINDS or not width.isdecimal() or len(width) > 4:
                continue  # an array of texts
            kind = np.dtype(blocks.order + _KINDS[element.get("type", "")])
            size = int(rows) * int(width)
            values = _values(blocks, element, kind, size)
            if len(values) != size:
                raise SceneError(f"{blocks.called}: {printable(name)} has {len(values)} values, but {size} are needed")
            arrays[name] = values if int(width) == 1 else values.reshape(int(rows), int(width))
    if "points" not in arrays:
        raise SceneError(f"{blocks.called}: a piece has no Points")
    return arrays


def _values(blocks: _Blocks, element: ElementTree.Element, kind: np.dtype[np.generic], count: int) -> Raw:
    text = (element.text or "").strip()
    if element.get("format") == "ascii":
        return np.array(text.split(), kind.newbyteorder("="))
    place = element.get("offset", "0")
    if element.get("format") != "appended":
        data, raw = text.encode(), False
    elif place.isdecimal() and int(place) < len(blocks.appended):
        data, raw = blocks.appended[int(place) :], blocks.raw
    else:
        raise SceneError(
            f"{blocks.called}: the offset {printable(place)} is beyond the appended data; the file ends early"
        )
    refuse_bomb(blocks.called, count * kind.itemsize, blocks.stored)
    content = _unpacked(blocks, data, raw, count * kind.itemsize)
    whole = len(content) - len(content) % kind.itemsize  # bytes of complete numbers, also in a truncated file
    return np.frombuffer(content[:whole], kind).astype(kind.newbyteorder("="))


def _unpacked(blocks: _Blocks, data: bytes, raw: bool, size: int) -> bytes:
    """Return the bytes of an array, of which there should be ``size``."""
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
