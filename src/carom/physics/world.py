"""The world: the bodies, the forces and contacts that act on them, and the clock."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from carom.arrays import FloatArray
from carom.errors import PhysicsError
from carom.physics.bodies import Bodies
from carom.physics.contact.hooks import Hooks, OptionalPart, PresentStep
from carom.physics.contact.impact_totals import ImpactTotals
from carom.physics.contact.law import materials_of
from carom.physics.contact.near_pairs import ContactWorld
from carom.physics.contact.pipeline import ContactPipeline
from carom.physics.contact.solid_records import solids_of
from carom.physics.diagnostics.run_monitor import Profile, remedies_of
from carom.physics.forces.force import TotalForce
from carom.physics.jit.team import Team
from carom.physics.shear_motion import ShearMotion
from carom.physics.sheared_box import ShearedBox
from carom.plan.features import Requirements, require
from carom.scene.load import Scene
from carom.scene.matter import pair_coefficients
from carom.scene.start import HalfSpaces, InitialBodies, names_of_solids
from carom.scene.units.dimension import TIME
from carom.scene.units.system import UnitSystem
from carom.scene.wording import Names

_INWARD = "bodies fall into each other's centres: set gravity.softening"
# remedies by the limit that sets the step
_CLOSE = {"error": _INWARD, "pull": f"{_INWARD}, or let them touch, contact.enabled"}


@dataclass(slots=True)
class Clock:
    """Number, times and length of the last step."""

    scene: Scene
    units: UnitSystem  # units of the scene; looking them up takes 2 µs
    step: int = 0
    time: float = 0.0  # s
    before: float = 0.0  # s, time before the last step
    dt: float = 0.0  # s
    limit: str = "start"  # the limit that set dt
    foreseen: dict[str, float] = field(default_factory=dict)  # number of the scene's own steps so far, by limit

    def advance(self, steps: int, before: float, time: float, dt: float, limit: str) -> None:
        """Advance by a number of steps; the other arguments are times (s), length (s) and limit of the last step.

        Raises PhysicsError if the last step did not change the time.
        """
        self.dt, self.limit = dt, limit
        if not time > before:
            raise PhysicsError(
                f"step {self.step + steps} of {self.units.text(dt, TIME, '.3g')} no longer moves the clock at t = "
                f"{self.units.text(before, TIME)} (limit: {limit}); {_remedy(self.scene, limit)}"
            )
        self.step += steps
        self.before, self.time = before, time

    def foresee(self, limit: str, steps: float) -> None:
        """Count steps of the length that the scene sets; a coarse look-ahead takes fewer, longer steps."""
        self.foreseen[limit] = self.foreseen.get(limit, 0.0) + steps


def _remedy(scene: Scene, limit: str) -> str:
    """Return the remedy for steps that are too short to change the clock, given the limit that sets them."""
    if limit in _CLOSE:
        return _CLOSE[limit]
    raised = remedies_of(scene).get(limit)
    if scene.time.accuracy is not None:
        return f"raise {raised}" if raised else "shorten time.duration"
    if limit in ("cap", "fixed"):
        return f"raise {raised}"
    return f"raise {raised or 'time.target_dx or time.cfl'}, or set time.fixed_dt"


@dataclass(frozen=True, slots=True)
class World:
    """The parts of a simulation that its steps share."""

    scene: Scene
    needs: Requirements
    names: Names
    bodies: Bodies
    planes: HalfSpaces
    is_periodic: bool
    box: FloatArray  # (3,) m, size of the periodic box, `ENDLESS` along other axes; zeros in open space
    falling: FloatArray  # (3,) m/s², the uniform field if it accelerates everything equally; otherwise zeros
    forces: TotalForce
    contact: ContactPipeline | None  # None if no contact is possible
    parts: Sequence[OptionalPart]  # optional parts of a step
    hooks: Hooks  # hooks of these parts
    step: PresentStep  # the present step
    clock: Clock
    team: Team
    profile: Profile

    @classmethod
    def at_start(cls, scene: Scene, start: InitialBodies, team: Team, records_contacts: bool) -> World:
        """Build the world of a scene before its first step."""
        needs, planes, profile = require(scene), solids_of(scene), Profile()
        bodies = Bodies.at_start(
            start,
            spins=needs.spin.modelled,
            orients=needs.orientation.modelled,
            torques=needs.torque.modelled,
            planes=len(planes.owner),
        )
        box = np.array(scene.domain.period or (0.0, 0.0, 0.0))
        forces = TotalForce(scene, needs, bodies, team, profile)
        at_rest = np.zeros(3)
        falling, bending = (at_rest, forces.uniform) if scene.anchored else (forces.uniform, at_rest)
        shear = ShearedBox(scene.domain.shear, box) if scene.domain.shear else None
        contact, step = None, PresentStep(profile)
        parts = [*forces.parts, *([ShearMotion(shear, bodies)] if shear else [])]
        if needs.contact.modelled:
            materials = materials_of(pair_coefficients(scene), planes.owner)
            world = ContactWorld(planes, materials, box, falling, bending, shear, needs.impact_time.modelled)
            totals = ImpactTotals(bodies, start.group, box, shear) if records_contacts else None
            contact = ContactPipeline(scene, bodies, world, needs, team, step, parts, totals)
            parts = contact.parts
        for part in parts:
            part.join(forces)
        return cls(
            scene=scene,
            needs=needs,
            names=Names(start.name, names_of_solids(scene) if planes.has_facets else planes.name),
            bodies=bodies,
            planes=planes,
            is_periodic=scene.domain.is_periodic,
            box=box,
            falling=falling,
            forces=forces,
            contact=contact,
            parts=parts,
            hooks=contact.hooks if contact else Hooks.of(parts),
            step=step,
            clock=Clock(scene, scene.unit_system),
            team=team,
            profile=profile,
        )
