"""The recording properties: their keys, and which values are valid."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from fnmatch import fnmatchcase
from typing import Any

from carom.errors import DamageError

MOST_BODIES = 10_000_000
LARGEST = 1e150  # largest coordinate or speed, so that squares do not overflow

NOTES = re.compile(r"data_notes\.[0-9]{1,9}")  # keys of notes on data files, one for each [[bodies]] table
_NUMBERS = re.compile(r"([0-9]{1,9}(,[0-9]{1,9})*)?")


def _text(value: Any) -> bool:
    return isinstance(value, str)


def _flag(value: Any) -> bool:
    return isinstance(value, bool)


def _whole(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool)


def _number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _positive(value: Any) -> bool:
    return _number(value) and 0.0 < value < math.inf


def _count(value: Any) -> bool:
    return _whole(value) and 1 <= value <= MOST_BODIES


def _vector(value: Any) -> bool:
    return isinstance(value, list) and len(value) == 3 and all(_number(part) and math.isfinite(part) for part in value)


def _bodies(value: Any) -> bool:
    return all(_whole(body) and 0 <= body < MOST_BODIES for body in (value if isinstance(value, list) else [value]))


def _numbers(value: Any) -> bool:
    return isinstance(value, str) and _NUMBERS.fullmatch(value) is not None


_WHAT: dict[Callable[[Any], bool], str] = {
    _text: "a text",
    _flag: "true or false",
    _whole: "a whole number",
    _number: "a number",
    _positive: "a positive number",
    _count: f"a number from 1 to {MOST_BODIES}",
    _vector: "three finite numbers",
    _bodies: "numbers of bodies",
    _numbers: "numbers of bodies with commas between them",
}

_KEYS: dict[str, dict[str, Callable[[Any], bool]]] = {
    "carom": {
        "title": _text,
        **dict.fromkeys(("units", "units.*"), _text),
        **dict.fromkeys(("colour_by", "drawn_as", "engine"), _text),
        "plane_names": _text,
        "data_notes.*": _text,
        "bodies": _count,
        **dict.fromkeys(("time_scale", "check_interval"), _positive),
        "origin": _vector,
        **dict.fromkeys(("box", "uniform_field"), _vector),
        "schema_version": _whole,
        "drawing_rules": _whole,
        "seed": _whole,
        "duration": _number,
        "arrow_length.*": _number,
        **dict.fromkeys(("spins", "has_*", "gravitates", "collides", "stabilises", "promises", "drives"), _flag),
        **dict.fromkeys(("body_colouring", "records_contacts", "states_at_impacts"), _flag),
    },
    "run": {"version.*": _text, "command": _text, "git": _text, "platform": _text, "cpu": _text},
    "arrows": {"*": _number},
    "clip": {"source": _text, "recording_id": _text, "from": _number, "to": _number, "bodies": _bodies},
    "outcome": {
        "outcome": _text,
        **dict.fromkeys(("frames", "steps", "contacts.total", "contacts.impacts", "moments.*.step"), _whole),
        **dict.fromkeys(("impacts.*", "audit.judged"), _whole),
        **dict.fromkeys(
            ("sim_time", "wall_time", "energy.*", "momentum.*", "angular_momentum.*", "accuracy.*"), _number
        ),
        **dict.fromkeys(("contacts.max_overlap", "moments.*.value", "moments.*.time", "profile.*"), _number),
        **dict.fromkeys(("moments.*.bodies", "moments.*.planes"), _numbers),
        "moments.*.between": _text,
        "expect.*.bound": _text,
        **dict.fromkeys(("laws.*.step", "laws.*.frames"), _whole),
        "laws.*.time": _number,
        "laws.*.text": _text,
        **dict.fromkeys(("expect.*.limit", "expect.*.measured"), _number),
        **dict.fromkeys(("expect.*.met", "expect.*.judged"), _flag),
    },
}
_REQUIRED = {"carom": ("bodies", "time_scale"), "clip": ("source", "from", "to"), "outcome": ("outcome",)}


def checked(name: str, values: Mapping[str, Any]) -> dict[str, Any]:
    """Return a property after checking the values of all known keys; an empty property was never written.

    Raises
    ------
    DamageError
        The message names the key and the valid values, if a value is wrong.
    """
    for key in _REQUIRED.get(name, ()) if values else ():
        if key not in values:
            raise DamageError(f"its property {name} has no {key}")
    for key, value in values.items():
        for pattern, is_right in _KEYS.get(name, {}).items():
            if fnmatchcase(key, pattern) and not is_right(value):
                raise DamageError(f"its property {name} has {key} = {str(value)[:40]!r} instead of {_WHAT[is_right]}")
    return dict(values)
