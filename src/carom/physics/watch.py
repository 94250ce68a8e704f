"""The energy check.

A closed system cannot gain energy, so a gain is a fault, and the contacts of the step before are its first suspects.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from carom.physics.bodies import Bodies
from carom.physics.contact.graph import CollisionGraph
from carom.physics.contact.load import FRICTION, RESTITUTION, STABILISATION
from carom.physics.energy import Energy
from carom.physics.event import Event
from carom.physics.names import Names

FloatArray = NDArray[np.float64]

MOST_CONTACTS = 6  # named in a warning, those that added most first
MOST_WARNINGS = 100  # in a run; a run that gains energy at every check has said so by then


@dataclass(frozen=True, slots=True)
class Suspects:
    """The contacts of one step as they were when it ended: copies, for a warning that may come a step later."""

    step: int
    graph: CollisionGraph
    contributions: FloatArray  # (m, 3) J, each contact's ledger
    velocity: FloatArray  # (m, 2, 3) m/s, of both bodies
    angular_velocity: FloatArray | None  # (m, 2, 3) rad/s

    @classmethod
    def of(cls, step: int, graph: CollisionGraph, contributions: FloatArray, bodies: Bodies) -> Suspects:
        """Copy what a warning would show."""
        spins = len(bodies.angular_velocity) > 0
        return cls(
            step=step,
            graph=graph,
            contributions=contributions,
            velocity=bodies.ends.velocity[graph.pairs],
            angular_velocity=bodies.ends.angular_velocity[graph.pairs] if spins else None,
        )

    def describe(self, names: Names) -> str:
        """Name the contacts that added most energy, with the states of their bodies."""
        if len(self.graph) == 0:
            return f"No bodies were colliding in step {self.step}."
        added = self.contributions[:, STABILISATION] - self.contributions[:, (RESTITUTION, FRICTION)].sum(axis=1)
        lines = [f"Colliding in step {self.step}, {len(self.graph)} contacts, those that added most first:"]
        lines += [self._contact(int(c), float(added[c]), names) for c in np.argsort(-added)[:MOST_CONTACTS]]
        return "\n".join(lines)

    def _contact(self, c: int, added: float, names: Names) -> str:
        lines = [f"  contact of overlap {self.graph.overlaps[c]:.3g} m added {added:+.3g} J"]
        for end, body in enumerate(self.graph.pairs[c]):
            text = f"    {names.of(int(body))}: v = {_vector(self.velocity[c, end])} m/s"
            if self.angular_velocity is not None:
                text += f", ω = {_vector(self.angular_velocity[c, end])} rad/s"
            lines.append(text)
        return "\n".join(lines)


@dataclass(frozen=True, slots=True)
class WatchTally:
    """What the watch knows from one check to the next."""

    last: Energy | None = None  # of the last check
    warnings: int = 0


class EnergyWatch:
    """Compares the energy from check to check and warns of a rise."""

    def __init__(self, tolerance: float, names: Names) -> None:
        self._tolerance = tolerance
        self._names = names
        self.tally = WatchTally()

    def check(self, step: int, time: float, energy: Energy, suspects: list[Suspects]) -> Event | None:
        """Warn if the total rose by more than the tolerance times the energy scale since the last check.

        The suspects are the contacts of the step before, whose bodies it names with their states, and of this one.
        """
        last, warnings = self.tally.last, self.tally.warnings
        rose = last is not None and energy.total - last.total > self._tolerance * energy.scale
        self.tally = WatchTally(energy, warnings + rose)
        if last is None or not rose or warnings >= MOST_WARNINGS:
            return None
        rise = energy.total - last.total
        stabilisation = energy.ledger.stabilisation - last.ledger.stabilisation
        integration = energy.integration_error - last.integration_error
        culprit = "stabilisation" if stabilisation > integration else "the integrator"
        text = (
            f"Energy rose by {rise:.4g} J ({rise / energy.scale:.2g} of the scale) since the last check: "
            f"{stabilisation:+.4g} J from stabilisation, {integration:+.4g} J from the integrator. "
            f"Mostly {culprit}."
        )
        text = "\n".join([text, *(step.describe(self._names) for step in suspects)])
        if self.tally.warnings == MOST_WARNINGS:
            text += f"\nThis is warning {MOST_WARNINGS}: further ones are not logged."
        return Event(step, time, "WARN", text, "energy-rise")


def _vector(values: FloatArray) -> str:
    return "(" + ", ".join(f"{value:.4g}" for value in values) + ")"
