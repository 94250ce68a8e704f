"""Words for messages: counts, suggestions, commands, and the names of bodies, planes and walls."""

from __future__ import annotations

import difflib
import html
import re
import shlex
from abc import abstractmethod
from bisect import bisect_right
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import accumulate
from pathlib import Path
from typing import overload

MOST_LISTED = 8  # largest number of bodies that a sentence lists by name
MOST_QUOTED = 80  # largest number of characters of a quoted text that is not a name
MOST_TOLD = 1000  # largest number of characters of an error's text
_PLAIN_WORD = re.compile("[A-Za-z0-9][A-Za-z0-9.+!_-]{0,79}")  # characters of packages' names and versions
# control characters except tab and line feed, marks of the direction of writing, and lone surrogates
_UNSAFE = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069\ud800-\udfff]")
_MARKS = re.compile(r"[\\`*_{}\[\]<>#|~!&]|(?<=:)/(?=/)")  # characters of Markdown, and of addresses that become links
_LINE_MARKS = re.compile(r"^(\d*)([-+=.)])")  # marks of lists and underlined headings


def command(*words: object) -> str:
    """Write a carom command, quoted as a shell requires, such as ``carom view 'my run.rrd'``."""
    return shlex.join(["carom", *(f"./{word}" if _is_like_an_option(word) else str(word) for word in words)])


def _is_like_an_option(word: object) -> bool:
    return isinstance(word, Path) and str(word).startswith("-")


def command_of_a_file(text: str) -> str:
    """Return a command line from a file: unchanged if it is a single plain command, otherwise as one quoted word.

    If somebody pastes the line into a shell, the shell starts nothing else: no second command, substitution or
    redirection.
    """
    try:
        words = shlex.split(text)
    except ValueError:  # a quotation has no end
        words = []
    return text if text == shlex.join(words) else shlex.quote(in_one_line(text))


def in_one_line(text: str) -> str:
    """Return a text from a file without control characters and line feeds, so that it cannot look like other lines."""
    return " ".join(escaped(text).split())


def told_by(error: BaseException) -> str:
    """Return the text of another program's error in one line, even if making the text raises another error."""
    try:
        return in_one_line(str(error)[:MOST_TOLD])
    except BaseException as other:
        return f"its text cannot be made ({type(other).__name__})"


def one_word(text: str) -> str:
    """Return a name or version from a file: unchanged if it looks like one, else its beginning as one quoted word."""
    return text if _PLAIN_WORD.fullmatch(text) else shlex.quote(in_one_line(text[:MOST_QUOTED]))


def hypertext(text: str) -> str:
    """Return a text from a file for a page: without tags, and with control characters as escapes."""
    return html.escape(escaped(text))


def literal(text: str) -> str:
    """Return a text from a file as one line of Markdown in which every character stands for itself."""
    return _LINE_MARKS.sub(r"\1\\\2", _MARKS.sub(r"\\\g<0>", in_one_line(text)))


def in_figure(text: str) -> str:
    """Return a text from a file as one line for matplotlib, which reads a text between two ``$`` as a formula."""
    return in_one_line(text).replace("$", r"\$")


def nearest(name: str, known: Iterable[str]) -> str:
    """Return the most similar known name; empty if none is similar."""
    return next(iter(difflib.get_close_matches(name, known, n=1, cutoff=0.5)), "")


def suggestion(name: str, known: Iterable[str]) -> str:
    """Name the most similar known name, and list all known names."""
    known = list(known)
    if not known:
        return "there is none"
    near, listed = nearest(name, known), ", ".join(known)
    return f'did you mean "{near}"? There are {listed}' if near else f"there are {listed}"


def counted(count: int, noun: str) -> str:
    """Return a number with its noun in the singular or the plural, such as "1 body" and "2 bodies"."""
    plural = f"{noun[:-1]}ies" if noun.endswith("body") else f"{noun}{'es' if noun.endswith('s') else 's'}"
    return f"{count} {noun if count == 1 else plural}"


def escaped(text: str) -> str:
    """Write control characters as escapes, as JSON does."""
    return _UNSAFE.sub(lambda match: f"\\u{ord(match[0]):04x}", text)


def body_called(number: int, name: str) -> str:
    """Name a body: ``body 3 "boulder"``, or ``body 3`` if it has no name of its own."""
    numbered = f"body {number}"
    return numbered if name in ("", numbered) else f'{numbered} "{name}"'


def body_key(number: int, name: str) -> str:
    """Name a body by its key in the scene file: ``body.3 ("boulder")``, or ``body.3``."""
    return f"body.{number}" if name in ("", f"body {number}") else f'body.{number} ("{name}")'


def bodies_called(numbers: Iterable[int], names: Sequence[str]) -> str:
    """List bodies by their numbers, given the names of all bodies; see `in_series`."""
    return in_series([body_called(number, names[number]) for number in numbers])


def in_series(called: Sequence[str]) -> str:
    """Join names as in a sentence; if they are many, the first few and the number of the remaining names."""
    listed = list(called[:MOST_LISTED])
    if len(called) > MOST_LISTED:
        listed.append(f"{len(called) - MOST_LISTED} more")
    return listed[0] if len(listed) == 1 else f"{', '.join(listed[:-1])} and {listed[-1]}"


@dataclass(frozen=True, slots=True)
class Names:
    """Names of the n bodies, followed by the planes and walls."""

    bodies: Sequence[str]
    planes: list[str]

    def of(self, end: int) -> str:
        """Name one end of a contact: a body like `body_called`, a plane or a wall by its name, if known."""
        plane = end - len(self.bodies)
        if plane < 0:
            return body_called(end, self.bodies[end])
        return self.planes[plane] if plane < len(self.planes) else f"plane {plane}"

    def pair(self, ends: Iterable[int]) -> str:
        """Name both ends of a contact."""
        return " and ".join(self.of(end) for end in ends)


class _LazyNames(Sequence[str]):
    """Names that are composed on access; equal to any sequence of the same names."""

    @abstractmethod
    def _at(self, place: int) -> str:
        """Return one name; the index is in range."""

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


@dataclass(eq=False)
class NumberedNames(_LazyNames):
    """``PREFIX FIRST``, ``PREFIX FIRST+1`` and so on."""

    prefix: str
    length: int
    first: int = 0

    def __len__(self) -> int:
        return self.length

    def _at(self, place: int) -> str:
        return f"{self.prefix} {self.first + place}"


@dataclass(eq=False)
class SomeNames(_LazyNames):
    """Names that are partly known; a number stands for each unknown name."""

    prefix: str
    length: int
    known: Mapping[int, str]

    def __len__(self) -> int:
        return self.length

    def _at(self, place: int) -> str:
        return self.known.get(place, f"{self.prefix} {place}")


class JoinedNames(_LazyNames):
    """Names of several parts, one part after another."""

    def __init__(self, parts: Sequence[Sequence[str]]) -> None:
        self.parts = tuple(parts)
        self._ends = list(accumulate(map(len, self.parts)))

    def __len__(self) -> int:
        return self._ends[-1] if self._ends else 0

    def _at(self, place: int) -> str:
        part = bisect_right(self._ends, place)
        return self.parts[part][place - (self._ends[part - 1] if part else 0)]


def joined(parts: Sequence[Sequence[str]]) -> Sequence[str]:
    """Return the names of all parts: as a list, unless a part is numbered."""
    if all(isinstance(part, list) for part in parts):
        return [name for part in parts for name in part]
    return JoinedNames(parts)
