"""The moments of a run worth looking at: where it was hardest, deepest, fullest and least exact."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from carom.physics.bodies import Bodies
from carom.physics.contact.graph import CollisionGraph
from carom.physics.frame import Event
from carom.physics.names import Names

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Moment:
    """An extreme of the run: its value, when, and which bodies."""

    value: float
    step: int
    time: float  # s
    bodies: tuple[int, ...] = ()


@dataclass(slots=True)
class Moments:
    """Extremes so far; None where there was nothing to measure."""

    energy_error: Moment | None = None  # |integration error| / scale, of the checked steps
    impact: Moment | None = None  # J, largest ½ μ v_n² of a contact that was closing
    overlap: Moment | None = None  # deepest overlap / smaller radius
    contacts: Moment | None = None  # most contacts in a step
    momentum_error: float | None = 0.0
    angular_momentum_error: float | None = 0.0
    total_contacts: int = 0  # summed over the steps
    impacts: int = 0  # contacts that closed faster than a contact at rest does, summed over the steps

    def see_contacts(
        self,
        step: int,
        time: float,
        graph: CollisionGraph,
        approach: FloatArray,
        rest_speed: FloatArray,
        bodies: Bodies,
    ) -> float:
        """Take note of a step's contacts; return the energy of those that were impacts, Σ ½ μ v_n² in joules."""
        i, j = graph.pairs.T
        ends = bodies.ends
        energy = 0.5 * approach * approach / (ends.inverse_mass[i] + ends.inverse_mass[j])
        depth = graph.overlaps / np.minimum(ends.radius[i], ends.radius[j])
        self.impact = _larger(self.impact, energy, step, time, graph)
        self.overlap = _larger(self.overlap, depth, step, time, graph)
        if self.contacts is None or len(graph) > self.contacts.value:
            self.contacts = Moment(len(graph), step, time)
        impacts = approach > rest_speed
        self.total_contacts += len(graph)
        self.impacts += int(np.count_nonzero(impacts))
        return float(energy[impacts].sum())

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

    def see_energy_error(self, step: int, time: float, error: float) -> None:
        """Take note of a checked energy."""
        if self.energy_error is None or error > self.energy_error.value:
            self.energy_error = Moment(error, step, time)

    def see_momentum_error(self, linear: float | None, angular: float | None) -> None:
        """Take note of checked momenta; None is what the scene does not conserve."""
        self.momentum_error = _worse(self.momentum_error, linear)
        self.angular_momentum_error = _worse(self.angular_momentum_error, angular)


def _worse(known: float | None, error: float | None) -> float | None:
    return None if known is None or error is None else max(known, error)


def _larger(known: Moment | None, values: FloatArray, step: int, time: float, graph: CollisionGraph) -> Moment | None:
    worst = int(np.argmax(values))
    if known is not None and values[worst] <= known.value:
        return known
    return Moment(float(values[worst]), step, time, tuple(int(body) for body in graph.pairs[worst]))
