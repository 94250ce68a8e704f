"""Names of many bodies without a string for each."""

from __future__ import annotations

from abc import abstractmethod
from bisect import bisect_right
from collections.abc import Iterator, Mapping, Sequence
from itertools import accumulate
from typing import overload


class _Names(Sequence[str]):
    """Names that are written when asked for; equal to any sequence of the same names."""

    @abstractmethod
    def _at(self, place: int) -> str:
        """Return one name; the place is in range."""

    @overload
    def __getitem__(self, index: int) -> str: ...
    @overload
    def __getitem__(self, index: slice) -> list[str]: ...
    def __getitem__(self, index: int | slice) -> str | list[str]:
        places = range(len(self))[index]
        return self._at(places) if isinstance(places, int) else [self._at(place) for place in places]

    def __iter__(self) -> Iterator[str]:
        return map(self._at, range(len(self)))

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Sequence) and len(self) == len(other) and all(map(str.__eq__, self, other))

    __hash__ = None  # type: ignore[assignment]


class NumberedNames(_Names):
    """``PREFIX FIRST``, ``PREFIX FIRST+1`` and so on."""

    def __init__(self, prefix: str, count: int, first: int = 0) -> None:
        self.prefix = prefix
        self.first = first
        self._count = count

    def __len__(self) -> int:
        return self._count

    def _at(self, place: int) -> str:
        return f"{self.prefix} {self.first + place}"


class SomeNames(_Names):
    """Names of which only some are known; the others are numbered."""

    def __init__(self, prefix: str, count: int, known: Mapping[int, str]) -> None:
        self._prefix = prefix
        self._count = count
        self._known = known

    def __len__(self) -> int:
        return self._count

    def _at(self, place: int) -> str:
        return self._known.get(place, f"{self._prefix} {place}")


class JoinedNames(_Names):
    """Names of several parts, one after the other."""

    def __init__(self, parts: Sequence[Sequence[str]]) -> None:
        self.parts = tuple(parts)
        self._ends = list(accumulate(map(len, self.parts)))

    def __len__(self) -> int:
        return self._ends[-1] if self._ends else 0

    def _at(self, place: int) -> str:
        part = bisect_right(self._ends, place)
        return self.parts[part][place - (self._ends[part - 1] if part else 0)]


def joined(parts: Sequence[Sequence[str]]) -> Sequence[str]:
    """Return the names of all parts: a list, unless a part is numbered."""
    if all(isinstance(part, list) for part in parts):
        return [name for part in parts for name in part]
    return JoinedNames(parts)
