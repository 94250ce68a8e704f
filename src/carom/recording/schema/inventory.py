"""The inventory of entities: which a recording of a scene has, and why."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from carom.plan.features import Requirements
from carom.recording.schema import paths
from carom.recording.schema.header import Header
from carom.recording.schema.series import SERIES

ONCE = "once, however long it is"

_PARTS = {  # entity → the part of the model that it requires
    paths.CONTACTS: "contact",
    paths.TORQUE: "torque",
    paths.ANGULAR_ACCELERATION: "torque",
}
_ALWAYS = {  # entity → why it is recorded
    paths.DT_LIMIT: "adaptive or not",
    paths.PHASE: "where it changes",
    paths.EVENTS: "where something happens",
    paths.FINGERPRINT: "the bits of every frame",
    paths.MOMENTUM: "momentum",
    paths.CHECKPOINT: "the exact state, at times",
    paths.STATIC_STATE: ONCE,
    paths.SCENE: ONCE,
    paths.SCENE_TOML: ONCE,
    paths.WORLD: ONCE,
}


class Content(NamedTuple):
    """An entity, whether a recording of the scene has it, and why."""

    path: str
    recorded: bool
    why: str


def _contact_data(header: Header) -> Iterator[Content]:
    without = "no contact" if not header.collides else 'record.impacts = "none"'
    kept = "all" if header.record_impacts == "all" else "at most a fifth of the file, else the largest"
    for path, why in ((paths.IMPACTS, kept), (paths.FORCE_NORMAL, "the largest impulses")):
        yield Content(path, header.records_contacts, why if header.records_contacts else without)
    rubs = header.records_contacts and header.has_friction
    why = "the same contacts" if rubs else without if not header.records_contacts else "no friction"
    yield Content(paths.FORCE_FRICTION, rubs, why)


def contents(header: Header, needs: Requirements) -> Iterator[Content]:
    """Return every entity that a recording may have."""
    parts = {part.name: part.modelled for part in needs.parts}
    yield Content(paths.BODIES, True, "centres and quaternions" if header.has_orientation else "centres")
    needed = [*_PARTS.items(), *((series.path, series.part) for series in SERIES)]
    for path, name in needed:
        there = name is None or parts[name]
        yield Content(path, there, (name or "always") if there else f"no {name}")
    yield from _contact_data(header)
    for path, why in _ALWAYS.items():
        yield Content(path, True, why)
    yield Content(paths.PLANES, header.planes is not None, ONCE if header.planes is not None else "no planes")
    yield Content(paths.WALLS, header.walls is not None, ONCE if header.walls is not None else "no walls")
    yield Content(paths.PERIODIC_BOX, header.box is not None, ONCE if header.box is not None else "no periodic box")
