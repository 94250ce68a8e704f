"""The values that a sweep varies, and their combinations."""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Mapping
from typing import Any

import tomlkit

from carom.scene.scene_file import parse_value

Values = tuple[Any, ...]  # TOML values: numbers, strings, booleans, lists

MOST_RUNS = 100_000  # largest number of runs; a million took 8 GB and ten minutes before the first run began
TOO_MANY_RUNS = f"more than {MOST_RUNS} runs; give fewer values"
_NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
_UNIT = r"[^\s:,\d\"'\[{][^:,\"'\[{]*?"
_RANGE = re.compile(rf"\s*({_NUMBER})\s*({_UNIT})?\s*:\s*({_NUMBER})\s*({_UNIT})?\s*:\s*(\d+)\s*(log)?\s*")
_LIKE_RANGE = re.compile(rf"\s*{_NUMBER}\s*(?:{_UNIT})?\s*:.*")
_EXAMPLES = "a list such as 0.2,0.6, a range 0.1:0.9:5 or a range of equal ratios 1e-3:1:4log"
_DIGITS = 12  # significant digits of a value in a range, which give 0.3, not 0.30000000000000004


def values_of(text: str) -> Values:
    """Read the values of a key from text; raises ValueError, which lists the valid forms.

    The forms are ``a,b,c``; ``first:last:count``, evenly spaced; and ``first:last:countlog``, in equal ratios. Ends are
    included and may have units: ``1 km:5 km:5``.
    """
    if matched := _RANGE.fullmatch(text):
        return _range(text, *matched.groups())
    return alike(parse_value(part) for part in _parts(text))


def texts_of(text: str) -> list[str]:
    """Read the values of a key as texts; see `values_of`."""
    if matched := _RANGE.fullmatch(text):
        return [value if isinstance(value, str) else repr(value) for value in _range(text, *matched.groups())]
    return _parts(text)


def alike(values: Any) -> Values:
    """Return the values as a tuple; if one is a float, whole numbers become floats.

    Raises ValueError if there are no values, or a value occurs twice.
    """
    listed = tuple(values)
    if not listed:
        raise ValueError(f"no values; expected {_EXAMPLES}")
    are_numbers = all(isinstance(value, int | float) and not isinstance(value, bool) for value in listed)
    if are_numbers and any(isinstance(value, float) for value in listed):
        listed = tuple(float(value) for value in listed)
    if len(listed) > MOST_RUNS:
        raise ValueError(TOO_MANY_RUNS)
    known: set[Any] = set()
    for value in listed:
        if (key := _hashable(value)) in known:
            raise ValueError(f"{value} is given twice; give it once")
        known.add(key)
    return listed


def _hashable(value: Any) -> Any:
    """Return a hashable equivalent of a value, since a set cannot hold lists and tables."""
    if isinstance(value, list):
        return tuple(map(_hashable, value))
    if isinstance(value, Mapping):
        return frozenset((key, _hashable(inner)) for key, inner in value.items())
    return value


def combinations(axes: Mapping[str, Values], zipped: bool) -> list[dict[str, Any]]:
    """Return the parameters of every run: all combinations of the values, or the k-th value of each key in run k.

    Raises ValueError if zipped lists differ in length, or there are too many runs.
    """
    if zipped:
        lengths = {key: len(values) for key, values in axes.items()}
        if len(set(lengths.values())) > 1:
            counts = ", ".join(f"{key} has {length}" for key, length in lengths.items())
            raise ValueError(f"zipped keys need equally many values: {counts}")
        rows: Any = zip(*axes.values(), strict=True) if axes else [()]
    else:
        if math.prod(len(values) for values in axes.values()) > MOST_RUNS:
            raise ValueError(TOO_MANY_RUNS)
        rows = itertools.product(*axes.values())
    return [dict(zip(axes, row, strict=True)) for row in rows]


def flattened(nested: Mapping[str, Any]) -> dict[str, Any]:
    """Write nested tables under dotted keys, since TOML reads an unquoted ``contact.restitution`` as a table."""
    flat: dict[str, Any] = {}
    for key, value in nested.items():
        if isinstance(value, Mapping):
            flat |= {f"{key}.{below}": inner for below, inner in flattened(value).items()}
        else:
            flat[key] = value
    return flat


def override(key: str, value: Any) -> str:
    """Write a parameter in the syntax of ``--set``."""
    return f"{key}={tomlkit.item(value).as_string()}"


def _parts(text: str) -> list[str]:
    if _LIKE_RANGE.fullmatch(text):
        raise ValueError(f'"{text}": a range has a first and a last value and their count; expected {_EXAMPLES}')
    parts = _split(text)
    if not all(parts):
        raise ValueError(f'"{text}": expected {_EXAMPLES}')
    return parts


def _range(
    text: str, first: str, unit: str | None, last: str, other: str | None, count: str, log: str | None
) -> Values:
    if unit != other:
        raise ValueError(f'"{text}": expected one unit at both ends, such as 1 km:5 km:5')
    if len(count.lstrip("0")) > len(str(MOST_RUNS)) or int(count) > MOST_RUNS:
        raise ValueError(TOO_MANY_RUNS)
    low, high, steps = float(first), float(last), int(count) - 1
    if not math.isfinite(high - low):
        raise ValueError(f'"{text}": the ends of a range, and their difference, must be finite numbers')
    if steps < 1:
        raise ValueError(f'"{text}": a range has two values or more; expected {_EXAMPLES}')
    if log and not (low > 0.0 and high > 0.0):
        raise ValueError(f'"{text}": equal ratios need two ends above 0')
    if log:
        ratio = math.log(high) - math.log(low)  # the quotient of both ends may overflow
        inner = [low * math.exp(ratio * step / steps) for step in range(1, steps)]
    else:
        inner = [low + (high - low) * step / steps for step in range(1, steps)]
    values = [low, *(float(f"{value:.{_DIGITS}g}") for value in inner), high]
    # written without a decimal point, so that a count remains an integer
    as_whole = all(number.lstrip("+-").isdigit() for number in (first, last))
    numbers = alike(map(int, values) if as_whole and all(value.is_integer() for value in values) else values)
    return tuple(f"{value} {unit}" for value in numbers) if unit else numbers


def _split(text: str) -> list[str]:
    """Split at the commas that are not inside brackets, braces or quotes."""
    parts, depth, quote = [""], 0, ""
    for character in text:
        if quote:
            quote = "" if character == quote else quote
        elif character in "\"'":
            quote = character
        depth += (not quote) * ((character in "[{") - (character in "]}"))
        if character == "," and not quote and depth == 0:
            parts.append("")
        else:
            parts[-1] += character
    return [part.strip() for part in parts]
