"""What bodies, planes and walls are called in every text that people read."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

MOST_LISTED = 8  # bodies that a sentence lists by name
# control characters except tab and line feed, marks that reverse the direction of writing, and lone surrogates
_UNSAFE = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u2028-\u202e\u2066-\u2069\ud800-\udfff]")


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
    """Join names as a sentence does; of many the first few, and how many more."""
    listed = list(called[:MOST_LISTED])
    if len(called) > MOST_LISTED:
        listed.append(f"{len(called) - MOST_LISTED} more")
    return listed[0] if len(listed) == 1 else f"{', '.join(listed[:-1])} and {listed[-1]}"


@dataclass(frozen=True, slots=True)
class Names:
    """Names of the n bodies, and of the planes and walls, whose indices follow."""

    bodies: Sequence[str]
    planes: list[str]

    def of(self, end: int) -> str:
        """Name one end of a contact: a body as `body_called` does, a plane or a wall by its name, if it is known."""
        plane = end - len(self.bodies)
        if plane < 0:
            return body_called(end, self.bodies[end])
        return self.planes[plane] if plane < len(self.planes) else f"plane {plane}"

    def pair(self, ends: Iterable[int]) -> str:
        """Name both ends of a contact."""
        return " and ".join(self.of(end) for end in ends)
