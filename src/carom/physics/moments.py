"""The moments of a run worth looking at: where it was hardest, deepest, fullest and least exact."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from carom.physics.bodies import Bodies
from carom.physics.contact.graph import CollisionGraph
from carom.physics.contact.sighting import Sighting
from carom.physics.energy import Energy
from carom.physics.event import Event
from carom.physics.kernel import kernel
from carom.physics.momentum import Momentum
from carom.physics.names import Names

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Moment:
    """An extreme of the run: its value, when, and which bodies."""

    value: float
    step: int
    time: float  # s
    bodies: tuple[int, ...] = ()


NOTHING = Moment(0.0, 0, 0.0)


@dataclass(slots=True)
class Moments:
    """Extremes so far, of the steps whose energy was taken, or of all contacts; None where nothing was measured.

    Contacts dissipate and gravity is conservative, so the total energy can only fall. What it rises by, from its lowest
    value on, is somebody's fault, whether the ledger has an entry for it or not.
    """

    energy_error: Moment | None = None  # |integration error| / scale
    energy_gain: Moment = NOTHING  # rise of the total energy from its lowest so far / scale
    kinetic: Moment = NOTHING  # kinetic energy / scale: of the last step, not the largest
    impact: Moment | None = None  # J, largest ½ μ v_n² of a contact that was closing
    overlap: Moment | None = None  # deepest overlap / smaller radius
    contacts: Moment | None = None  # most contacts in a step
    momentum_error: Moment | None = NOTHING  # None where the scene does not conserve it
    angular_momentum_error: Moment | None = NOTHING  # likewise
    total_contacts: int = 0  # summed over the steps
    impacts: int = 0  # contacts that closed faster than a contact at rest does, summed over the steps
    lowest_energy: float = float("inf")  # J

    def see_contacts(self, step: int, time: float, sighting: Sighting, bodies: Bodies) -> float:
        """Take note of a step's contacts; return the energy of those that were impacts, Σ ½ μ v_n² in joules."""
        graph, ends, seen = sighting.graph, bodies.ends, np.empty(5)
        approach, rest_speed = sighting.approach, sighting.rest_speed
        _extremes(graph.pairs, graph.overlaps, approach, rest_speed, ends.inverse_mass, ends.radius, seen)
        hardest, energy, deepest, depth, struck = seen.tolist()
        self.impact = _larger(self.impact, energy, int(hardest), step, time, graph)
        self.overlap = _larger(self.overlap, depth, int(deepest), step, time, graph)
        if self.contacts is None or len(graph) > self.contacts.value:
            self.contacts = Moment(float(len(graph)), step, time)
        self.total_contacts += len(graph)
        self.impacts += sighting.impacts
        return float(struck)

    def highlights(self, names: Names) -> tuple[Event, ...]:
        """Put the extremes of contacts and energy into words, in order of time."""
        wordings = (
            (self.impact, "Hardest impact of the run, {value:.4g} J"),
            (self.overlap, "Deepest overlap of the run, {value:.3%} of the smaller radius"),
            (self.contacts, "Most contacts of the run, {value:.0f}"),
            (self.energy_error, "Largest integration error of the run, {value:.2e} of the energy scale"),
        )
        events = []
        for moment, wording in wordings:
            if moment is not None and moment.value > 0:
                who = " and ".join(names.of(body) for body in moment.bodies)
                text = wording.format(value=moment.value) + (f": {who}." if who else ".")
                events.append(Event(moment.step, moment.time, "INFO", text))
        return tuple(sorted(events, key=lambda event: event.step))

    def see_energy(self, step: int, time: float, energy: Energy) -> None:
        """Take note of the energy of a step."""
        self.energy_error = _worse(self.energy_error, energy.relative_error, step, time)
        self.lowest_energy = min(self.lowest_energy, energy.total)
        gain = (energy.total - self.lowest_energy) / energy.scale if energy.scale > 0.0 else 0.0
        if gain > self.energy_gain.value:
            self.energy_gain = Moment(gain, step, time)
        kinetic = energy.translational + energy.rotational
        self.kinetic = Moment(kinetic / energy.scale if energy.scale > 0.0 else 0.0, step, time)

    def see_momentum(self, step: int, time: float, momentum: Momentum) -> None:
        """Take note of the momenta of a step."""
        linear, angular = momentum.linear_error, momentum.angular_error
        self.momentum_error = None if linear is None else _worse(self.momentum_error, linear, step, time)
        self.angular_momentum_error = (
            None if angular is None else _worse(self.angular_momentum_error, angular, step, time)
        )


def _worse(known: Moment | None, value: float, step: int, time: float) -> Moment:
    return known if known is not None and value <= known.value else Moment(value, step, time)


def _larger(
    known: Moment | None, value: float, worst: int, step: int, time: float, graph: CollisionGraph
) -> Moment | None:
    if len(graph) == 0 or (known is not None and value <= known.value):
        return known
    return Moment(value, step, time, tuple(int(body) for body in graph.pairs[worst]))


@kernel
def _extremes(
    pairs: NDArray[np.int64],
    overlaps: FloatArray,
    approach: FloatArray,
    rest_speed: FloatArray,
    inverse_mass: FloatArray,
    radius: FloatArray,
    seen: FloatArray,
) -> None:
    """Write the hardest contact and its ½ μ v_n² in J, the deepest and its depth, and Σ ½ μ v_n² of the impacts."""
    for k in range(5):
        seen[k] = 0.0
    for c in range(len(pairs)):
        i, j = pairs[c, 0], pairs[c, 1]
        energy = 0.5 * approach[c] * approach[c] / (inverse_mass[i] + inverse_mass[j])
        depth = overlaps[c] / min(radius[i], radius[j])
        if energy > seen[1]:
            seen[0], seen[1] = c, energy
        if depth > seen[3]:
            seen[2], seen[3] = c, depth
        if approach[c] > rest_speed[c]:
            seen[4] += energy
