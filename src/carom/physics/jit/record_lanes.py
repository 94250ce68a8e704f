"""Eight records whose fields are lanes, for code generators.

Records are read and written as whole cache lines, which are transposed in registers. A transposition takes 24
instructions, so what several lines gain is transposed once, and added to them in memory.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from llvmlite import ir

from carom.physics.aligned import CACHE_LINE
from carom.physics.jit.lanes import (
    BYTE,
    DOUBLE,
    NOTHING,
    VECTOR,
    WIDTH,
    WORD,
    Lanes,
    Mask,
    gathered,
    shuffled,
    spread,
)

HALF = WIDTH // 2


class RecordLanes:
    """Eight records; the fields of the lines that were read are attributes.

    Parameters
    ----------
    builder
        Of the code.
    kind
        Type of the records, whole cache lines.
    addresses
        Of the records.
    lines
        Cache lines to read.
    """

    def __init__(self, builder: Any, kind: np.dtype[np.void], addresses: Sequence[Any], lines: Sequence[int]) -> None:
        self._builder, self._kind, self._addresses = builder, kind, addresses
        self._lines = {line: _read(builder, addresses, line) for line in lines}

    def __getattr__(self, name: str) -> Lanes:
        line, place = self._place_of(name)
        return self._lines[line][place]

    def field(self, name: str) -> Lanes:
        """Return a field of a line that was not read; the line is not transposed."""
        line, place = self._place_of(name)
        places = [_at(self._builder, at, line * CACHE_LINE + 8 * place, DOUBLE) for at in self._addresses]
        return gathered(self._builder, [self._builder.load(at) for at in places])

    def change(self, **fields: Lanes) -> None:
        """Change fields of lines that were read, not yet in memory."""
        for name, value in fields.items():
            line, place = self._place_of(name)
            self._lines[line][place] = value

    def write(self, line: int, mask: Mask | None = None) -> None:
        """Write a line that was read, in the records of a mask (default: in all)."""
        rows = _rows_of(self._builder, self._lines[line])

        def write(k: int) -> None:
            self._builder.store(rows[k], line_of(self._builder, self._addresses[k], line), align=CACHE_LINE)

        if mask is None:
            for k in range(WIDTH):
                write(k)
        else:
            mask.in_each(write)

    def add(self, lines: Sequence[int], fields: Sequence[Lanes], mask: Mask) -> None:
        """Add eight fields to each of some lines in memory, in the records of a mask."""
        builder, rows = self._builder, _rows_of(self._builder, fields)

        def add(k: int) -> None:
            for line in lines:
                place = line_of(builder, self._addresses[k], line)
                builder.store(builder.fadd(builder.load(place, align=CACHE_LINE), rows[k]), place, align=CACHE_LINE)

        mask.in_each(add)

    def add_to(self, mask: Mask, **fields: Lanes) -> None:
        """Add to named fields of a cache line in memory, in the records of a mask; the others keep their bits."""
        (line,) = {self._place_of(name)[0] for name in fields}
        row = [spread(self._builder, NOTHING)] * WIDTH
        for name, value in fields.items():
            row[self._place_of(name)[1]] = value
        self.add((line,), row, mask)

    def _place_of(self, name: str) -> tuple[int, int]:
        """Return the line of a field, and its place in the line."""
        if name not in (self._kind.fields or {}):
            raise AttributeError(f"these records have no {name}")
        assert self._kind.fields is not None
        offset = self._kind.fields[name][1]
        return offset // CACHE_LINE, offset % CACHE_LINE // 8


def _read(builder: Any, addresses: Sequence[Any], line: int) -> list[Lanes]:
    """Read a cache line of eight records; return its eight fields."""
    vectors = []
    for part in range(2):  # halves of two lines make a vector, which saves a step of the transposition
        halves = [builder.load(_half_of(builder, address, line, part), align=CACHE_LINE // 2) for address in addresses]
        pairs = zip(halves[:HALF], halves[HALF:], strict=True)
        vectors += [shuffled(builder, *pair, range(WIDTH)) for pair in pairs]
    return [Lanes(builder, column) for column in _exchanged(builder, vectors, (1, 2))]


def _rows_of(builder: Any, fields: Sequence[Lanes]) -> list[Any]:
    """Return the cache lines of eight records with these fields."""
    return _exchanged(builder, [field.value for field in fields], (1, 2, 4))


def _exchanged(builder: Any, vectors: list[Any], steps: Sequence[int]) -> list[Any]:
    """Exchange single lanes, pairs or halves of eight vectors; all three steps transpose them."""
    for step in steps:
        firsts = [k - k % (2 * step) + k % step + (WIDTH if k % (2 * step) >= step else 0) for k in range(WIDTH)]
        exchanged = list(vectors)
        for k in range(WIDTH):
            if k % (2 * step) < step:
                both = vectors[k], vectors[k + step]
                exchanged[k] = shuffled(builder, *both, firsts)
                exchanged[k + step] = shuffled(builder, *both, [lane + step for lane in firsts])
        vectors = exchanged
    return vectors


def line_of(builder: Any, address: Any, line: int) -> Any:
    """Return the address of a cache line of a record, as that of a vector."""
    return _at(builder, address, line * CACHE_LINE, VECTOR)


def _half_of(builder: Any, address: Any, line: int, part: int) -> Any:
    return _at(builder, address, line * CACHE_LINE + part * CACHE_LINE // 2, ir.VectorType(DOUBLE, HALF))


def _at(builder: Any, address: Any, offset: int, kind: Any) -> Any:
    """Return the address of a value some bytes after another address."""
    moved = builder.gep(builder.bitcast(address, BYTE.as_pointer()), [WORD(offset)])
    return builder.bitcast(moved, kind.as_pointer())
