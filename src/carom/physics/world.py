"""The world: bodies and everything that acts on them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from carom.arrays import FloatArray
from carom.physics.bodies import Bodies
from carom.physics.clock import Clock
from carom.physics.contact.law import materials_of
from carom.physics.contact.pipeline import ContactPipeline
from carom.physics.diagnostics.run_monitor import Profile
from carom.physics.forces.total import TotalForce
from carom.physics.jit.thread_team import Team
from carom.plan.features import Requirements, require
from carom.scene.matter import pair_coefficients
from carom.scene.schema import Scene
from carom.scene.start import HalfSpaces, InitialBodies, half_spaces
from carom.scene.wording import Names


@dataclass(frozen=True, slots=True)
class World:
    """The parts of a simulation that its steps share."""

    scene: Scene
    needs: Requirements
    names: Names
    bodies: Bodies
    planes: HalfSpaces
    is_periodic: bool
    box: FloatArray  # (3,) m, size of the periodic box; zeros in open space
    falling: FloatArray  # (3,) m/s², the uniform field if it accelerates everything alike, otherwise zeros
    forces: TotalForce
    contact: ContactPipeline | None  # None if no contact is possible
    clock: Clock
    team: Team
    profile: Profile

    @classmethod
    def at_start(cls, scene: Scene, start: InitialBodies, team: Team, records_contacts: bool) -> World:
        """Build the world of a scene before its first step."""
        needs, planes, profile = require(scene), half_spaces(scene), Profile()
        bodies = Bodies.at_start(
            start,
            spins=needs.spin.modelled,
            orients=needs.orientation.modelled,
            torques=needs.torque.modelled,
            planes=len(planes),
        )
        is_periodic = scene.domain.boundary == "periodic"
        box = np.array(scene.domain.size if is_periodic else (0.0, 0.0, 0.0))
        forces = TotalForce(scene, needs, bodies, team, profile)
        at_rest = np.zeros(3)
        falling, bending = (at_rest, forces.uniform) if scene.anchored else (forces.uniform, at_rest)
        contact = None
        if needs.contact.modelled:
            materials = materials_of(pair_coefficients(scene))
            ends = bodies, planes, materials
            contact = ContactPipeline(scene.contact, *ends, needs, box, falling, bending, team, records_contacts)
        return cls(
            scene=scene,
            needs=needs,
            names=Names(start.name, planes.name),
            bodies=bodies,
            planes=planes,
            is_periodic=is_periodic,
            box=box,
            falling=falling,
            forces=forces,
            contact=contact,
            clock=Clock(scene, scene.unit_system),
            team=team,
            profile=profile,
        )
