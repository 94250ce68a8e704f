"""Energy terms and the ledger: what the run has, what contacts took out, what stabilisation put in.

    E = Σ ½ m v² + Σ ½ I ω² - Σ G m_i m_j / √(r_ij² + ε²) - Σ m g·x
    E(t) + dissipated(t) - injected(t) - E(0)  =  the integration error, and nothing else

The error is compared with the largest kinetic + |gravitational| energy so far. Without a uniform field or anything
fixed the kinetic part counts from the centre of mass: a scene that moves as a whole is held to the same standard.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from carom.physics.bodies import Bodies
from carom.physics.contact.load import FRICTION, RESTITUTION, STABILISATION
from carom.physics.kernel import kernel
from carom.physics.momentum import centre_velocity

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Ledger:
    """Energy moved by contacts since the start of the run, summed from the impulses themselves, in joules.

    Dissipation counts positive when energy left the bodies; stabilisation counts positive when it entered them.
    """

    restitution: float = 0.0  # taken out by the normal impulses
    friction: float = 0.0  # taken out by the tangential impulses
    stabilisation: float = 0.0  # put in by pushing overlapping bodies apart (Baumgarte bias or split)

    def plus(self, contacts: FloatArray) -> Ledger:
        """Return the ledger after a step, given the contacts' own, (m, 3) J."""
        step = np.zeros(3)
        _sum_rows(contacts, step)
        return Ledger(
            self.restitution + float(step[RESTITUTION]),
            self.friction + float(step[FRICTION]),
            self.stabilisation + float(step[STABILISATION]),
        )

    @property
    def balance(self) -> float:
        """What left less what entered."""
        return self.restitution + self.friction - self.stabilisation


@dataclass(frozen=True, slots=True)
class Energy:
    """The terms of the total energy at one moment, in joules.

    ``integration_error`` is E(t) + dissipated(t) - injected(t) - E(0): what the integrator alone got wrong.
    """

    translational: float  # Σ ½ m v²
    rotational: float  # Σ ½ I ω²
    gravitational: float  # -Σ G m_i m_j / √(r_ij² + ε²)
    field: float  # -Σ m g·x, of the uniform field
    ledger: Ledger
    integration_error: float
    scale: float  # largest kinetic + |gravitational| so far; without a field, kinetic about the centre of mass

    @property
    def total(self) -> float:
        """Sum of the four terms."""
        return self.translational + self.rotational + self.gravitational + self.field

    @property
    def relative_error(self) -> float:
        """|integration error| over the energy scale; 0 where there is no energy."""
        return abs(self.integration_error) / self.scale if self.scale > 0.0 else 0.0


@dataclass(frozen=True, slots=True)
class EnergyBaseline:
    """What energies are compared with."""

    initial: float  # J, the total at the start of the run
    scale: float  # J, the largest so far


class EnergyAccount:
    """Turns the state into an `Energy`, remembering where the run began and the largest scale so far."""

    def __init__(self, field: FloatArray, anchored: bool = False) -> None:
        self._field = field
        self._at_rest = anchored or bool(field.any())  # whether motion counts from rest, not from the centre of mass
        self.baseline: EnergyBaseline | None = None  # None before the first call

    def balance(self, bodies: Bodies, gravitational: float, ledger: Ledger) -> Energy:
        """Take stock. The first call is the start of the run."""
        translational, internal, rotational, field = _terms(
            bodies.position, bodies.velocity, bodies.angular_velocity, bodies.mass, bodies.inertia, self._field
        )
        total = translational + rotational + gravitational + field
        moving = translational if self._at_rest else internal
        scale = moving + rotational + abs(gravitational)
        known = self.baseline or EnergyBaseline(total, scale)
        self.baseline = EnergyBaseline(known.initial, max(known.scale, scale))
        return Energy(
            translational=translational,
            rotational=rotational,
            gravitational=gravitational,
            field=field,
            ledger=ledger,
            integration_error=total - self.baseline.initial + ledger.balance,
            scale=self.baseline.scale,
        )


@kernel
def _terms(
    position: FloatArray,
    velocity: FloatArray,
    angular_velocity: FloatArray,
    mass: FloatArray,
    inertia: FloatArray,
    g: FloatArray,
) -> tuple[float, float, float, float]:
    """Return the kinetic energy, the one about the centre of mass, the rotational one and that of the field, in J."""
    Vx, Vy, Vz = centre_velocity(velocity, mass)
    translational, internal, rotational, field = 0.0, 0.0, 0.0, 0.0
    for i in range(len(mass)):
        vx, vy, vz = velocity[i, 0], velocity[i, 1], velocity[i, 2]
        translational += 0.5 * mass[i] * (vx * vx + vy * vy + vz * vz)
        vx, vy, vz = vx - Vx, vy - Vy, vz - Vz
        internal += 0.5 * mass[i] * (vx * vx + vy * vy + vz * vz)
        field -= mass[i] * (g[0] * position[i, 0] + g[1] * position[i, 1] + g[2] * position[i, 2])
    for i in range(len(angular_velocity)):
        wx, wy, wz = angular_velocity[i, 0], angular_velocity[i, 1], angular_velocity[i, 2]
        rotational += 0.5 * inertia[i] * (wx * wx + wy * wy + wz * wz)
    return translational, internal, rotational, field


@kernel
def _sum_rows(rows: FloatArray, total: FloatArray) -> None:
    for c in range(len(rows)):
        for k in range(3):
            total[k] += rows[c, k]
