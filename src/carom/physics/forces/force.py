"""The protocols of forces, the forces of a scene, and their sum.

A force that depends only on positions adds an acceleration and may have a potential. The kind of a force states which
scenes require the force, and how its energy is recorded (`carom.scene.forces`). Each of carom's own forces has a
function ``make(scene, bodies, team)``, named in `carom.registry`. `carom.physics.forces.kernel_forces` makes the forces
of installed packages.

Forces without a potential do work along the paths of the bodies. On a drift from x to x + Δx, with the accelerations a
and a' by the force at its ends,

    W = Σ ½ m (a + a')·Δx

This is the work of leapfrog's kicks, up to a term that remains bounded. If the integrator has dense output,
Gauss–Legendre quadrature with five nodes integrates

    W = Σ m ∫ a·v dt
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import sqrt
from typing import Any, NamedTuple, Protocol

import numpy as np

from carom import registry
from carom.arrays import FloatArray
from carom.physics.bodies import Bodies
from carom.physics.contact.hooks import LedgerAccount, OptionalPart, PresentStep
from carom.physics.diagnostics.run_monitor import Profile
from carom.physics.forces import kernel_forces
from carom.physics.forces.gravity import gravity_of
from carom.physics.forces.kernel_forces import KernelForce, Parameters
from carom.physics.jit.decorators import kernel
from carom.physics.jit.team import Team
from carom.plan.auto import uses_tree
from carom.plan.features import Requirements
from carom.scene.forces import FORCES, UNIFORM_FIELD, ForceKind
from carom.scene.load import Scene

Potentials = dict[str, float]  # J, energy by term
DRIVING_FIELD = "driving_field"  # entry of the ledger: the negative work of the uniform field along periodic axes

_INNER, _OUTER = sqrt(5.0 - 2.0 * sqrt(10.0 / 7.0)) / 3.0, sqrt(5.0 + 2.0 * sqrt(10.0 / 7.0)) / 3.0
_HEAVY, _LIGHT = (322.0 + 13.0 * sqrt(70.0)) / 900.0, (322.0 - 13.0 * sqrt(70.0)) / 900.0
# nodes and weights in [-1, 1]; the quadrature of polynomials up to degree 9 is exact
QUADRATURE = ((-_OUTER, _LIGHT), (-_INNER, _HEAVY), (0.0, 128.0 / 225.0), (_INNER, _HEAVY), (_OUTER, _LIGHT))


class Force(Protocol):
    """A force that accelerates bodies."""

    kind: ForceKind  # states in which scenes the force acts, and the name of its energy term
    uniform: FloatArray  # (3,) m/s², the part of the acceleration that is the same for every body

    def accelerate(self, position: FloatArray, acceleration: FloatArray, *, first: bool, potential: bool) -> float:
        """Add the acceleration at positions, (n, 3) m/s² and m; return the potential energy in joules if requested.

        The ``first`` force overwrites ``acceleration``. A force without a potential returns 0.
        """


class Exchange(NamedTuple):
    """The energy that left the bodies during a part of a step, and the external impulses."""

    loss: float  # J
    impulse: FloatArray  # (3,) N s
    angular_impulse: FloatArray  # (3,) N m s, angular impulse about the origin


def accelerate(
    forces: Sequence[Force], position: FloatArray, acceleration: FloatArray, potential: bool, profile: Profile
) -> Potentials:
    """Write the acceleration by all forces; return their potential energies if requested."""
    energies: Potentials = {}
    for index, force in enumerate(forces):
        energy = force.accelerate(position, acceleration, first=index == 0, potential=potential)
        if potential and force.kind.potential:
            energies[force.kind.potential] = energy
        profile.mark(force.kind.short_name)
    return energies


class ForceLaws(NamedTuple):
    """The forces of a scene for kernels that sum them over all pairs."""

    attracts: bool  # whether bodies attract each other
    constant: float  # m³/(kg s²), G
    softening: float  # m
    uniform: FloatArray  # (f, 3) m/s², uniform acceleration of each force that has one, in the order of summation
    others: Parameters  # parameters of forces from installed packages, as for `add_forces`
    damping: tuple[Any, ...]  # the `Damping.law` for `kick_before_drift`; empty if no force depends on velocities


class Damping(OptionalPart):
    """A force that depends on velocities; as a part of a step, it makes its own kicks."""

    law: tuple[Any, ...]  # parameters of the force for kernels, which recognise the force by the type of this tuple


class PathWork(OptionalPart):
    """The work W of a force in the present step; the ledger's entry has the sign of a loss: -W.

    ``accelerate`` writes the accelerations by the force, (n, 3) m/s², at positions, (n, 3) m, to its second argument.
    """

    def __init__(self, entry: str, accelerate: Callable[[FloatArray, FloatArray], object], bodies: Bodies) -> None:
        self.entry = entry
        self._accelerate = accelerate
        self._bodies = bodies
        self._start = bodies.position.copy()
        self._before, self._after = np.zeros_like(self._start), np.zeros_like(self._start)
        self._work = 0.0  # J

    def depart(self, step: PresentStep) -> None:
        """Begin a drift at the present positions."""
        self._start[:] = self._bodies.position
        self._accelerate(self._start, self._before)

    def travelled(self, step: PresentStep) -> None:
        """Add the work of the drift."""
        position = self._bodies.position
        self._accelerate(position, self._after)
        self._work += _work(self._bodies.mass, self._before, self._after, position - self._start)

    def follow(self, dt: float, solution: Callable[[float], tuple[FloatArray, FloatArray]]) -> None:
        """Add the work of a step of dt seconds, given its dense output.

        ``solution`` returns positions and velocities, (n, 3) m and m/s, at a time (s) before the end of the step.
        """
        for node, weight in QUADRATURE:
            position, velocity = solution(0.5 * (1.0 - node) * dt)
            self._accelerate(position, self._after)
            self._work += 0.5 * weight * dt * _work(self._bodies.mass, self._after, self._after, velocity)

    def book(self, account: LedgerAccount) -> None:
        """Book the work of the step."""
        account.book_work(self.entry, self._work)
        self._work = 0.0

    def discard(self) -> None:
        """Discard the work so far."""
        self._work = 0.0


@kernel
def _work(mass: FloatArray, before: FloatArray, after: FloatArray, displacement: FloatArray) -> float:
    """Sum ½ m (a + a')·Δx, in J; with velocities in place of displacements, the power in W."""
    work = 0.0
    for i in range(len(mass)):
        along = 0.0
        for k in range(3):
            along += 0.5 * (before[i, k] + after[i, k]) * displacement[i, k]
        work += mass[i] * along
    return work


class TotalForce:
    """Accelerates the bodies of a scene by all its forces.

    `losses` are the ledger's entries for forces without a potential. The work of forces that do not depend on
    velocities, `path_works`, is booked step by step.
    """

    def __init__(self, scene: Scene, needs: Requirements, bodies: Bodies, team: Team, profile: Profile) -> None:
        self._scene, self._needs = scene, needs
        self._bodies = bodies
        self._team = team
        self._profile = profile
        self.find_fixed()
        # required forces, in the order in which accelerations are added
        kinds = [kind for kind in FORCES if needs.forces[kind.name].modelled]
        self._forces: list[Force] = [registry.load("forces", kind.name)(scene, bodies, team) for kind in kinds]
        self._forces += [kernel_forces.make(name, scene, bodies, team) for name in scene.forces.given]
        self.uniform: FloatArray = np.sum([np.zeros(3), *(force.uniform for force in self._forces)], axis=0)
        # at most one force depends on velocities
        self.damping = next((force for force in self._forces if isinstance(force, Damping)), None)
        self.losses = [force.kind.loss for force in self._forces if force.kind.loss]
        own = (force for force in self._forces if isinstance(force, KernelForce))
        self.path_works = [PathWork(force.kind.loss, force.write, bodies) for force in own if force.kind.loss]
        if any(scene.driving_field):
            driving = np.array(scene.driving_field)

            def accelerate_by_field(position: FloatArray, acceleration: FloatArray) -> None:
                acceleration[:] = driving

            self.losses.append(DRIVING_FIELD)
            self.path_works.append(PathWork(DRIVING_FIELD, accelerate_by_field, bodies))
        self.parts: list[OptionalPart] = [*([self.damping] if self.damping else []), *self.path_works]

    def find_fixed(self) -> None:
        """Find the bodies that no force moves, after a caller has fixed or released bodies."""
        self._fixed = np.flatnonzero(self._bodies.ends.inverse_mass[: len(self._bodies)] == 0.0)

    @property
    def laws(self) -> ForceLaws | None:
        """The forces for a kernel that takes many steps; None with gravity by a tree."""
        needs, gravity = self._needs, self._scene.gravity
        if uses_tree(self._scene):
            return None
        others = tuple(force.parameters for force in self._forces if isinstance(force, KernelForce))
        mutual = needs.gravity.modelled, gravity.constant, gravity.softening
        alike = [force.uniform for force in self._forces if force.uniform.any() or force.kind is UNIFORM_FIELD]
        return ForceLaws(*mutual, np.array(alike).reshape(-1, 3), others, self.damping.law if self.damping else ())

    def accelerate(self, potential: bool) -> Potentials:
        """Update the accelerations of the bodies; return the potential energies if requested."""
        bodies = self._bodies
        energies = accelerate(self._forces, bodies.position, bodies.acceleration, potential, self._profile)
        if len(self._fixed):
            bodies.acceleration[self._fixed] = 0.0
        return energies

    def potentials(self) -> Potentials:
        """Return the potential energies at the present positions.

        The accelerations do not change: in drift-kick-drift, accelerations belong to the middle of the step, and the
        choice of the next step must not depend on whether an energy is requested.
        """
        unused = np.empty_like(self._bodies.acceleration)
        return accelerate(self._forces, self._bodies.position, unused, True, Profile())

    def potential_of_fixed_bodies(self) -> float:
        """Return the constant gravitational energy between fixed bodies, in J."""
        fixed = self._fixed
        gravity = gravity_of(self._scene, self._bodies.mass[fixed], self._team) if len(fixed) > 1 else None
        if gravity is None:
            return 0.0
        return gravity.accelerate(self._bodies.position[fixed], np.empty((len(fixed), 3)), potential=True) or 0.0
