"""The properties of a recording: one table of the values that are written, read and accepted under each key.

A recording may come from a stranger, so values of wrong kinds are refused before they are used.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from fnmatch import fnmatchcase
from functools import partial
from operator import attrgetter
from typing import Any

import numpy as np

from carom.arrays import FloatArray
from carom.errors import DamageError
from carom.recording.schema.header import Header, scene_digest
from carom.recording.schema.paths import SCHEMA_VERSION
from carom.scene.extensions import PROPERTY
from carom.scene.forces import FORCES, GRAVITY, UNIFORM_FIELD

MOST_BODIES = 10_000_000

ANY, TEXT, FLAG, WHOLE, NUMBER = "anything", "a text", "true or false", "a whole number", "a number"
POSITIVE, COUNT, VECTOR = "a positive number", f"a number from 1 to {MOST_BODIES}", "three finite numbers"
BODIES, NUMBERS = "numbers of bodies", "numbers of bodies with commas between them"

_VALID: dict[str, Callable[[Any], bool]] = {
    ANY: lambda value: True,
    TEXT: lambda value: isinstance(value, str),
    FLAG: lambda value: isinstance(value, bool),
    WHOLE: lambda value: isinstance(value, int) and not isinstance(value, bool),
    NUMBER: lambda value: isinstance(value, int | float) and not isinstance(value, bool),
    POSITIVE: lambda value: _VALID[NUMBER](value) and 0.0 < value < math.inf,
    COUNT: lambda value: _VALID[WHOLE](value) and 1 <= value <= MOST_BODIES,
    VECTOR: lambda value: (
        isinstance(value, list) and len(value) == 3 and all(_VALID[NUMBER](x) and math.isfinite(x) for x in value)
    ),
    BODIES: lambda value: all(
        _VALID[WHOLE](body) and 0 <= body < MOST_BODIES for body in (value if isinstance(value, list) else [value])
    ),
    NUMBERS: lambda value: isinstance(value, str) and re.fullmatch(r"([0-9]{1,9}(,[0-9]{1,9})*)?", value) is not None,
}
_READ: dict[str, Callable[[Any], Any]] = {NUMBER: float, POSITIVE: float, VECTOR: np.asarray}


@dataclass(frozen=True, slots=True)
class Property:
    """One key of a property, or a pattern of keys."""

    key: str
    kind: str
    # returns the value for a header, or values by key; None is not written. Rows without `write` are written elsewhere
    write: Callable[[Header], Any] | None = None
    is_field: bool = False  # whether the property is read into the header's field with this name
    is_required: bool = False


def _rows(kind: str, keys: str) -> list[Property]:
    return [Property(key, kind) for key in keys.split()]


def _fields(kind: str, keys: str) -> list[Property]:
    """Return properties with the values of fields of the header; values of None are not written."""
    return [Property(key, kind, attrgetter(key), is_field=True) for key in keys.split()]


def _if_true(kind: str, keys: str, *, is_field: bool = True) -> list[Property]:
    """Return properties with the values of the header; false and empty values are not written."""
    return [Property(key, kind, partial(_true, key), is_field) for key in keys.split()]


def _true(key: str, header: Header) -> Any:
    return getattr(header, key) or None


def _below(prefix: str, values: Mapping[str, Any]) -> dict[str, Any]:
    return {f"{prefix}{key}": value for key, value in values.items()}


def _notes(header: Header) -> dict[str, str]:
    return {f"data_notes.{k}": "\n".join(notes) for k, notes in enumerate(header.data_notes) if notes}


def _normals(header: Header) -> dict[str, FloatArray]:
    """Return the normals of another engine's planes in double precision; drawings have only single precision."""
    planes = header.planes if header.engine else None
    return {f"plane_normal.{k}": normal for k, normal in enumerate(() if planes is None else planes.normal)}


def _offsets(header: Header) -> dict[str, float]:
    planes = header.planes if header.engine else None
    return {f"plane_offset.{k}": offset for k, offset in enumerate([] if planes is None else planes.offset.tolist())}


def _forces(header: Header) -> dict[str, bool]:
    """Return whether there are gravity and a uniform field, and the names of other forces."""
    present = {kind.present: kind.name in header.forces for kind in FORCES}
    return {key: value for key, value in present.items() if value or key in (GRAVITY.present, UNIFORM_FIELD.present)}


PROPERTIES: dict[str, list[Property]] = {
    "carom": [  # the scene, the parts of its model, and the style of the drawing
        Property("schema_version", WHOLE, lambda h: SCHEMA_VERSION),
        Property("bodies", COUNT, attrgetter("bodies"), is_required=True),
        Property("time_scale", POSITIVE, is_required=True),
        Property("records_contacts", FLAG, attrgetter("records_contacts")),
        Property("colour_by", TEXT, attrgetter("coloured_by")),
        Property("scene_sha256", ANY, lambda h: scene_digest(h.scene_toml) if h.scene_toml else None),
        Property("plane_names", TEXT, lambda h: "\n".join(h.planes.name) if h.engine and h.planes else None),
        Property("plane_normal.*", VECTOR, _normals),
        Property("plane_offset.*", NUMBER, _offsets),
        Property("units*", TEXT, lambda h: h.units.properties()),
        Property("data_notes.*", TEXT, _notes),
        Property("pistons", TEXT, lambda h: " ".join(map(str, h.pistons)) or None),
        Property("outlets", TEXT, lambda h: "\n".join(h.outlets) or None),
        Property("shear.*", ANY, lambda h: _below("shear.", h.shear.model_dump() if h.shear else {})),
        Property(f"{PROPERTY}*", ANY, lambda h: _below(PROPERTY, h.extensions)),
        *_fields(TEXT, "title"),
        *_fields(FLAG, "spins has_orientation has_torque has_friction collides stabilises body_colouring"),
        *_fields(WHOLE, "seed"),
        *_fields(NUMBER, "duration"),
        *_fields(POSITIVE, "check_interval"),
        *_fields(VECTOR, "box uniform_field"),
        *_if_true(NUMBER, "gravity_constant gravity_softening"),
        *_if_true(TEXT, "engine drawn_as"),
        *_if_true(FLAG, "promises has_driving_field"),
        *_if_true(FLAG, "drives has_piston admits", is_field=False),
        *(Property(kind.present, FLAG, _forces if kind is GRAVITY else None) for kind in FORCES),
        *_rows(VECTOR, "origin"),
        *_rows(NUMBER, "arrow_length.*"),
    ],
    "run": [  # with rows that a caller adds
        *_rows(TEXT, "version.* command git platform cpu"),
        *_rows(WHOLE, "threads"),
        *_rows(ANY, "*"),
    ],
    "sweep": [*_rows(TEXT, "name"), *_rows(ANY, "*")],  # with rows for the varying values
    "arrows": _rows(NUMBER, "*"),
    "clip": [
        *(Property(key, kind, is_required=True) for key, kind in (("source", TEXT), ("from", NUMBER), ("to", NUMBER))),
        *_rows(TEXT, "recording_id"),
        *_rows(BODIES, "bodies"),
        *_rows(FLAG, "partial"),
    ],
    "repair": _rows(TEXT, "source lost"),
    "diff": _rows(TEXT, "a b verdict"),
    "tradeoff": _rows(TEXT, "courses"),
    "outcome": [
        Property("outcome", TEXT, is_required=True),
        *_rows(TEXT, "moments.*.between expect.*.bound expect.*.between laws.*.text contacts.impacts_counted"),
        *_rows(WHOLE, "frames steps contacts.total contacts.impacts moments.*.step impacts.* audit.judged"),
        *_rows(WHOLE, "laws.*.step laws.*.frames"),
        *_rows(NUMBER, "sim_time wall_time energy.* momentum.* angular_momentum.* accuracy.* profile.*"),
        *_rows(NUMBER, "contacts.max_overlap moments.*.value moments.*.time laws.*.time laws.*.excess"),
        *_rows(NUMBER, "expect.*.limit expect.*.measured expect.*.time"),
        *_rows(NUMBER, "audit.parted audit.forced audit.damping.* audit.angular_damping.*"),
        *_rows(NUMBERS, "moments.*.bodies moments.*.planes laws.*.bodies"),
        *_rows(FLAG, "expect.*.met expect.*.judged"),
    ],
}


def stated(header: Header) -> dict[str, Any]:
    """Return the values of the property `carom` that follow from a header."""
    found: dict[str, Any] = {}
    for each in PROPERTIES["carom"]:
        if each.write is not None and (value := each.write(header)) is not None:
            found |= value if isinstance(value, Mapping) else {each.key: value}
    return found


def fields_read(info: Mapping[str, Any]) -> dict[str, Any]:
    """Return the fields of a header that the property `carom` states."""
    rows = [each for each in PROPERTIES["carom"] if each.is_field and each.key in info]
    return {each.key: _READ.get(each.kind, lambda value: value)(info[each.key]) for each in rows}


def checked(name: str, values: Mapping[str, Any]) -> dict[str, Any]:
    """Return a property, which is empty if it was never written; DamageError names a key with an invalid value."""
    table = PROPERTIES.get(name, [])
    for row in table:
        if values and row.is_required and row.key not in values:
            raise DamageError(f"its property {name} has no {row.key}")
    for key, value in values.items():
        for row in table:
            if fnmatchcase(key, row.key) and not _VALID[row.kind](value):
                raise DamageError(f"its property {name} has {key} = {str(value)[:40]!r} instead of {row.kind}")
    return dict(values)
