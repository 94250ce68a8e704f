"""The sum of all forces of a scene."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from carom.arrays import FloatArray
from carom.physics.bodies import Bodies
from carom.physics.diagnostics.run_monitor import Profile
from carom.physics.forces.force import Damping, Potentials, accelerate, forces_of
from carom.physics.forces.gravity import gravity_of
from carom.physics.forces.kernel_forces import KernelForce, Parameters
from carom.physics.jit.thread_team import Team
from carom.plan.auto import uses_tree
from carom.plan.features import Requirements
from carom.scene.schema import Scene


class ForceLaws(NamedTuple):
    """The forces of a scene for kernels that sum them over all pairs."""

    attracts: bool  # whether bodies pull each other
    constant: float  # m³/(kg s²), G
    softening: float  # m
    is_uniform: bool  # whether there is a field
    uniform: FloatArray  # (3,) m/s²
    others: Parameters  # those of installed packages, for `add_forces`


class TotalForce:
    """Accelerates the bodies of a scene by all its forces.

    Attributes
    ----------
    uniform
        (3,) m/s², the part of the acceleration that is the same for every body.
    damping
        The force that depends on velocities, if there is one.
    losses
        The ledger's entries for forces without a potential.
    """

    def __init__(self, scene: Scene, needs: Requirements, bodies: Bodies, team: Team, profile: Profile) -> None:
        self._scene, self._needs = scene, needs
        self._bodies = bodies
        self._team = team
        self._profile = profile
        self._fixed = np.flatnonzero(bodies.ends.inverse_mass[: len(bodies)] == 0.0)
        self._forces = forces_of(scene, needs, bodies, team)
        self.uniform: FloatArray = np.sum([np.zeros(3), *(force.uniform for force in self._forces)], axis=0)
        self.damping = next((force for force in self._forces if isinstance(force, Damping)), None)
        self.losses = [force.kind.loss for force in self._forces if force.kind.loss]

    @property
    def laws(self) -> ForceLaws | None:
        """The forces for a kernel that takes many steps; None with drag, or with gravity by a tree."""
        needs, gravity = self._needs, self._scene.gravity
        if self.damping or uses_tree(self._scene):
            return None
        others = tuple(force.parameters for force in self._forces if isinstance(force, KernelForce))
        pulls = needs.gravity.modelled, gravity.constant, gravity.softening
        return ForceLaws(*pulls, needs.field.modelled, self.uniform, others)

    def accelerate(self, potential: bool) -> Potentials:
        """Update the accelerations of the bodies; return the potential energies if requested."""
        bodies = self._bodies
        energies = accelerate(self._forces, bodies.position, bodies.acceleration, potential, self._profile)
        if len(self._fixed):
            bodies.acceleration[self._fixed] = 0.0
        return energies

    def potentials(self) -> Potentials:
        """Return the potential energies of the present positions.

        The accelerations are not changed. Those of drift-kick-drift are of the middle of the step, and the next step is
        chosen by them whether or not an energy is requested.
        """
        unused = np.empty_like(self._bodies.acceleration)
        return accelerate(self._forces, self._bodies.position, unused, True, Profile())

    def potential_of_fixed_bodies(self) -> float:
        """Return the constant gravitational energy of fixed bodies among each other, in J."""
        fixed = self._fixed
        gravity = gravity_of(self._scene, self._bodies.mass[fixed], self._team) if len(fixed) > 1 else None
        if gravity is None:
            return 0.0
        return gravity.accelerate(self._bodies.position[fixed], np.empty((len(fixed), 3)), potential=True) or 0.0
