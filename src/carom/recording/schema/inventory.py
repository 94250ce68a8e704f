"""Which entities a recording has, and which part of the model each one shows."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from carom.plan.features import Requirements
from carom.recording.schema import paths
from carom.recording.schema.header import Header

ONCE = "once, however long it is"

_PARTS = {  # entity → the part of the model without which it is not there
    paths.CONTACTS: "contact",
    paths.TORQUE: "torque",
    paths.ANGULAR_ACCELERATION: "torque",
    f"{paths.ENERGY}/rotational": "spin",
    f"{paths.ENERGY}/gravitational": "potential",
    f"{paths.ENERGY}/field": "uniform-field",
    f"{paths.LEDGER}/restitution": "contact",
    f"{paths.LEDGER}/friction": "friction",
    f"{paths.LEDGER}/stabilisation": "stabilisation",
    paths.STEP_CONTACTS: "contact",
    paths.COLOURS: "contact",
    paths.SWEEPS: "contact",
    paths.OVERLAP: "contact",
    paths.RELATIVE_OVERLAP: "contact",
}
_ALWAYS = {  # entity → why it is there
    f"{paths.ENERGY}/translational": "energy",
    f"{paths.ENERGY}/total": "energy",
    paths.INTEGRATION_ERROR: "energy less the ledger",
    paths.RELATIVE_ERROR: "energy less the ledger",
    paths.DT: "adaptive or not",
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


def contents(header: Header, needs: Requirements) -> Iterator[Content]:
    """Return every entity that a recording may have."""
    parts = {part.name: part.modelled for part in needs.parts}
    yield Content(paths.BODIES, True, "centres and quaternions" if header.has_orientation else "centres")
    for path, name in _PARTS.items():
        yield Content(path, parts[name], name if parts[name] else f"no {name}")
    for path, why in _ALWAYS.items():
        yield Content(path, True, why)
    yield Content(paths.PLANES, header.planes is not None, ONCE if header.planes is not None else "no planes")
    yield Content(paths.WALLS, header.walls is not None, ONCE if header.walls is not None else "no walls")
    yield Content(paths.PERIODIC_BOX, header.box is not None, ONCE if header.box is not None else "no periodic box")
