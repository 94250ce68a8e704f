"""The audit of impulses: compares changes of velocities with the impulses of contacts and the kicks of forces.

For every body, in each step,

    Δv = Σ J/m + Σ a h,    Δω = Σ (ρ λ_t × n ± Λ) / I,    J = λ_n n + λ_t, which acts on j, and -J on i

must hold with the impulses that the contact tap reports, and with the integrator's kicks a h. The change of the ledger
is compared with the sum of the contacts' work. Drag multiplies velocities, so its effect is measured, not computed.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from carom.arrays import FloatArray
from carom.contact_table import turning_impulses
from carom.physics.bodies import Bodies
from carom.physics.contact.contact_tap import ContactTap, Impulses
from carom.physics.contact.pipeline import ContactPipeline
from carom.state.energies import Ledger


class ImpulseAudit:
    """Compares the changes of velocity in each step with the sums of impulses and kicks."""

    def __init__(self, bodies: Bodies, contact: ContactPipeline | None) -> None:
        self._bodies, self._contact = bodies, contact
        self._tap = contact.part(ContactTap) if contact else None
        self._before = bodies.velocity, bodies.angular_velocity
        self.begin(Ledger())

    def begin(self, ledger: Ledger) -> None:
        """Begin a step with the present velocities and ledger."""
        bodies = self._bodies
        self._ledger = _terms(ledger)
        self._velocity, self._spin = bodies.velocity.copy(), bodies.angular_velocity.copy()
        # arrays (n, 3) in m/s: velocity changes by forces in this step so far, in order
        self.kicks: list[FloatArray] = []
        self._fastest = _largest(self._velocity)  # m/s, largest speed in the step so far

    def add_kick(self, acceleration: FloatArray, dt: float) -> None:
        """Add a kick of (n, 3) m/s² for dt s."""
        self.add_force(acceleration * dt)

    def __enter__(self) -> None:
        """Begin a change of velocities and spins that is not due to impulses of contacts."""
        self._before = self._bodies.velocity.copy(), self._bodies.angular_velocity.copy()

    def __exit__(self, *error: object) -> None:
        """Add the change since `__enter__`."""
        velocity, spin = self._before
        self.add_force(self._bodies.velocity - velocity)
        self._spin = self._spin + (self._bodies.angular_velocity - spin)

    def add_force(self, change: FloatArray) -> None:
        """Add changes of velocities by forces, (n, 3) m/s."""
        self.kicks.append(change)
        self._fastest = max(self._fastest, _largest(change), _largest(self._bodies.velocity))

    def finish(self, ledger: Ledger) -> tuple[float, tuple[int, ...]]:
        """Return the largest error, and the body to which it belongs, if any.

        Errors of velocities, and of spins times the radius, are relative to the largest speed in the step. The largest
        speed includes the changes by kicks and, for each body, the sum of the magnitudes of J/m: impulses in a heavy
        pile may cancel, but each impulse is rounded separately. The change of the ledger in the step should be the sum
        of the work of all contacts; errors are relative to the largest entry of the ledger.
        """
        bodies, work = self._bodies, np.zeros((0, 3))
        if self._tap and self._contact:
            work = np.concatenate((self._tap.work(), *(part.losses() for part in self._contact.parts)))
        given = _Given.of(self._tap.impulses() if self._tap else (), bodies)
        kicked = sum(self.kicks, np.zeros_like(self._velocity))
        velocity = bodies.velocity - self._velocity - kicked - given.velocity
        spin = (bodies.angular_velocity - self._spin - given.spin) * bodies.radius[: len(self._spin), np.newaxis]
        errors = np.sqrt((velocity * velocity).sum(axis=1))
        errors[: len(spin)] = np.maximum(errors[: len(spin)], np.sqrt((spin * spin).sum(axis=1)))
        turning = bodies.angular_velocity * bodies.radius[: len(spin), np.newaxis]
        fastest = max(self._fastest, _largest(bodies.velocity), _largest(turning), float(given.speed.max(initial=0.0)))
        worst = int(errors.argmax())
        of_bodies = float(errors[worst]) / fastest if fastest > 0.0 else 0.0
        now = _terms(ledger)
        summed = np.abs(work).sum(axis=0)
        scale = max(float(np.abs(now).max()), float(np.abs(self._ledger).max()), float(summed.max()))
        error = float(np.abs(now - self._ledger - work.sum(axis=0)).max())
        of_ledger = error / scale if scale > 0.0 else 0.0
        if of_ledger > of_bodies:
            return of_ledger, ()
        return of_bodies, (worst,) if of_bodies > 0.0 else ()


@dataclass(frozen=True, slots=True)
class _Given:
    """Changes of the bodies by the impulses of a step."""

    velocity: FloatArray  # (n, 3) m/s, changes of velocity
    spin: FloatArray  # (n, 3) rad/s, changes of spin; (0, 3) if nothing spins
    speed: FloatArray  # (n,) m/s, Σ |J| / m: change of speed if all impulses had one direction

    @classmethod
    def of(cls, impulses: Iterable[Impulses], bodies: Bodies) -> _Given:
        ends, n = bodies.ends, len(bodies)
        velocity, spin = np.zeros_like(ends.velocity), np.zeros_like(ends.angular_velocity)
        speed = np.zeros(len(ends.velocity))
        for some in impulses:
            normal, friction = some.normal, some.values[:, 1:]
            J = some.values[:, :1] * normal + friction
            length = np.sqrt((J * J).sum(axis=1))
            turns = turning_impulses(normal, some.arms if some.turns else 0.0 * some.arms, friction, some.angular)
            for end, sign in ((0, -1.0), (1, 1.0)):
                body = some.pairs[:, end]
                inverse_mass = ends.inverse_mass[body]
                np.add.at(velocity, body, sign * inverse_mass[:, np.newaxis] * J)
                np.add.at(speed, body, inverse_mass * length)
                if len(spin):
                    np.add.at(spin, body, ends.inverse_inertia[body][:, np.newaxis] * turns[:, end])
        return cls(velocity[:n], spin[: len(bodies.angular_velocity)], speed[:n])


def _terms(ledger: Ledger) -> FloatArray:
    return np.array([ledger.restitution, ledger.friction, ledger.stabilisation])


def _largest(vectors: FloatArray) -> float:
    """Return the largest length of vectors, (k, 3); 0 if there are none."""
    return float(np.sqrt((vectors * vectors).sum(axis=1).max(initial=0.0)))
