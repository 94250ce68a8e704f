"""The protocols of forces, and the forces of a scene.

A force that depends on positions only adds an acceleration and may have a potential. Its kind states when a scene
requires it and what it records (`carom.scene.forces`). The module of one of carom's own forces has its name and defines
``make(scene, bodies, team)``; those of installed packages are made by `carom.physics.forces.kernel_forces`.
"""

from __future__ import annotations

from collections.abc import Sequence
from importlib import import_module
from typing import NamedTuple, Protocol, runtime_checkable

from carom.arrays import FloatArray
from carom.physics.bodies import Bodies
from carom.physics.contact.events.drift import Impacts
from carom.physics.diagnostics.run_monitor import Profile
from carom.physics.forces import kernel_forces
from carom.physics.jit.thread_team import Team
from carom.plan.features import Requirements
from carom.scene.forces import FORCES, ForceKind
from carom.scene.schema import Scene

Potentials = dict[str, float]  # J, by their terms of the energy


class Force(Protocol):
    """Accelerates bodies.

    Attributes
    ----------
    kind
        When it is modelled, and the name of its energy.
    uniform
        (3,) m/s², the part of the acceleration that is the same for every body.
    """

    kind: ForceKind
    uniform: FloatArray

    def accelerate(self, position: FloatArray, acceleration: FloatArray, *, first: bool, potential: bool) -> float:
        """Add its acceleration at positions, both (n, 3); return its potential energy in joules if requested.

        Parameters
        ----------
        position
            m
        acceleration
            m/s²
        first
            Whether this is the first force: ``acceleration`` is then overwritten.
        potential
            Whether the energy is requested; otherwise, or without a potential, 0 is returned.
        """


class DampedStep(NamedTuple):
    """A leapfrog step with a force that depends on velocities: kick, factor, drift, factor, kick."""

    length: float  # s
    first_kick: float  # s
    before: float  # factor of the velocities before the drift, which makes them their mean along it
    after: float  # factor after the drift
    last_kick: float  # s
    share: float  # s, of the step: its part of the other forces' work in the drift is booked before the drift
    held_kick: float  # s, effective length of the first kick where contacts are held


class Exchange(NamedTuple):
    """The energy that left the bodies in a part of a step, and the external impulses."""

    loss: float  # J
    impulse: FloatArray  # (3,) N s
    angular_impulse: FloatArray  # (3,) N m s, about the origin


@runtime_checkable
class Damping(Force, Protocol):
    """A force that depends on velocities. It defines its own kicks and factors, and books the energy that it takes.

    Its row in the table has ``damps`` set and names the entry of the ledger. A scene has at most one such force.
    """

    def step(self, dt: float) -> DampedStep:
        """Return kicks and factors of a step in seconds."""

    def begin(self, step: DampedStep) -> Exchange:
        """Kick, and change velocities to their mean along the drift."""

    def end(self, step: DampedStep) -> Exchange:
        """Change velocities from their mean along the drift to those at its end, and kick."""

    def along(self, step: DampedStep) -> FloatArray:
        """Return the rate at which velocities change along the drift, (n + p, 3) m/s²."""

    def against(self) -> FloatArray:
        """Return the accelerations against which contacts are held, (n + p, 3) m/s²: those at the start of the step."""

    def lost_in_hold(self, step: DampedStep, before: FloatArray) -> float:
        """Return the change of its loss by holding the contacts, in joules.

        ``before`` are the velocities before the hold, (n + p, 3) m/s.
        """

    def lost_in_impacts(self, step: DampedStep, before: FloatArray, impacts: Impacts) -> float:
        """Return the change of its loss by impacts during the drift, in joules; ``before`` is overwritten.

        ``before`` are the velocities at the beginning of the drift, (n + p, 3) m/s.
        """


def forces_of(scene: Scene, needs: Requirements, bodies: Bodies, team: Team) -> list[Force]:
    """Make the forces that a scene requires, in the order in which accelerations are summed."""
    own = [_make(kind, scene, bodies, team) for kind in FORCES if needs.forces[kind.name].modelled]
    return [*own, *(kernel_forces.make(name, scene, bodies, team) for name in scene.forces.given)]


def _make(kind: ForceKind, scene: Scene, bodies: Bodies, team: Team) -> Force:
    module = import_module(f"{__package__}.{kind.name.replace('-', '_')}")
    force: Force = module.make(scene, bodies, team)
    return force


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
