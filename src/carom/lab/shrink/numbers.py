"""Writes every number with the fewest digits that still show the failure."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from carom.lab.shrink.literal import BODIES, ORIGIN, Document, Path, value_at, with_value
from carom.lab.shrink.smallest import Smallest

MOST_DIGITS = 17
_FIXED_FRAME = ("plane", "domain", "drag")  # sections that hold bodies to a place or a velocity
_KEPT = {"expect"}  # sections whose numbers say what a failure is


def round_numbers(smallest: Smallest) -> bool:
    """Shorten numbers, first all together, then one by one; tell whether any was."""
    changed = _move_frame(smallest)
    for digits in range(1, MOST_DIGITS):
        if smallest.takes_as_short(_mapped(smallest.document, lambda value, digits=digits: rounded(value, digits))):  # type: ignore[misc]
            changed = True
            break
    for path in list(_paths(smallest.document)):
        changed |= _shorten(smallest, path)
    return changed


def rounded(value: float, digits: int) -> float:
    """Round to so many significant digits; with 0 digits to 0."""
    return float(f"{value:.{digits - 1}e}") if digits else 0.0


def digits_of(value: float) -> int:
    """Return the number of significant digits that write a number exactly; 0 has none."""
    return 0 if value == 0.0 else next(d for d in range(1, MOST_DIGITS + 1) if rounded(value, d) == value)


def _shorten(smallest: Smallest, path: Path) -> bool:
    value = value_at(smallest.document, path)
    if not isinstance(value, float):
        return False
    for digits in range(digits_of(value)):
        if smallest.takes_as_short(_tidy(with_value(smallest.document, path, rounded(value, digits)))):
            return True
    return False


def _move_frame(smallest: Smallest) -> bool:
    """Put the origin into the first body, and let it rest, where neither matters."""
    if any(key in smallest.document for key in _FIXED_FRAME):
        return False
    changed = False
    for key in ("position", "velocity"):
        bodies = smallest.document[BODIES]
        origin = bodies[0].get(key, ORIGIN)
        if any(origin) and not any(body.get("fixed") for body in bodies):
            moved = [body | {key: _difference(body.get(key, ORIGIN), origin)} for body in bodies]
            changed |= smallest.takes_as_short(_tidy(smallest.document | {BODIES: moved}))
    return changed


def _difference(one: list[float], other: list[float]) -> list[float]:
    return [a - b for a, b in zip(one, other, strict=True)]


def _tidy(document: Document) -> Document:
    """Leave out vectors of zeros, which are the defaults."""
    bodies = [{key: value for key, value in body.items() if value != ORIGIN} for body in document[BODIES]]
    return document | {BODIES: bodies}


def _mapped(document: Document, change: Callable[[float], float]) -> Document:
    """Change every number of a document."""
    for path in list(_paths(document)):
        document = with_value(document, path, change(float(value_at(document, path))))
    return _tidy(document)


def _paths(node: object, above: Path = ()) -> Iterator[Path]:
    """Yield the paths of all numbers with a fraction; whole numbers are counts."""
    if isinstance(node, dict):
        for key, value in node.items():
            yield from _paths(value, (*above, key)) if key not in _KEPT else ()
    elif isinstance(node, list):
        for k, value in enumerate(node):
            yield from _paths(value, (*above, k))
    elif isinstance(node, float):
        yield above
