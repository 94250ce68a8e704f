"""What a force is to a step, and how the forces of a scene are found.

A force that depends on positions alone adds an acceleration, and has a potential or none. Its kind, a row of
`carom.scene.forces.FORCES`, says when a scene requires it and what it records. The module of that name offers
``make(scene, bodies, team)``.
"""

from __future__ import annotations

from collections.abc import Sequence
from importlib import import_module
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from carom.physics.bodies import Bodies
from carom.physics.diagnostics.profile import Profile
from carom.physics.parallel.thread_team import Team
from carom.plan.features import Requirements
from carom.scene.forces import FORCES, ForceKind
from carom.scene.schema import Scene

FloatArray = NDArray[np.float64]
Potentials = dict[str, float]  # J, by their terms of the energy


class Force(Protocol):
    """Accelerates bodies.

    Attributes
    ----------
    kind
        Its row in the list of forces.
    uniform
        (3,) m/s², the part of the acceleration that is the same for every body.
    """

    kind: ForceKind
    uniform: FloatArray

    def accelerate(self, position: FloatArray, acceleration: FloatArray, *, first: bool, potential: bool) -> float:
        """Add its acceleration at positions, both (n, 3); return its potential energy in joules if that is asked for.

        Parameters
        ----------
        position
            m
        acceleration
            m/s²
        first
            Whether nothing stands in ``acceleration`` yet: it is then overwritten.
        potential
            Whether the energy is asked for; 0 is returned if not, or if the force has no potential.
        """


def forces_of(scene: Scene, needs: Requirements, bodies: Bodies, team: Team) -> list[Force]:
    """Make the forces that a scene requires, in the order of the list."""
    return [_make(kind, scene, bodies, team) for kind in FORCES if needs.forces[kind.name].modelled]


def _make(kind: ForceKind, scene: Scene, bodies: Bodies, team: Team) -> Force:
    module = import_module(f"{__package__}.{kind.name.replace('-', '_')}")
    force: Force = module.make(scene, bodies, team)
    return force


def accelerate(
    forces: Sequence[Force], position: FloatArray, acceleration: FloatArray, potential: bool, profile: Profile
) -> Potentials:
    """Write the acceleration by all forces; return their potential energies if they are asked for."""
    energies: Potentials = {}
    for index, force in enumerate(forces):
        energy = force.accelerate(position, acceleration, first=index == 0, potential=potential)
        if potential and force.kind.potential:
            energies[force.kind.potential] = energy
        profile.mark(force.kind.short_name)
    return energies
