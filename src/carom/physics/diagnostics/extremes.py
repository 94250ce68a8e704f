"""The moments of a run worth looking at: where it was hardest, deepest, fullest and least exact."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

from carom.physics.contact.statistics import Tally
from carom.physics.diagnostics.momentum import Momentum
from carom.physics.energy import Energy
from carom.physics.event import Event
from carom.physics.names import Names


@dataclass(frozen=True, slots=True)
class Moment:
    """An extreme of the run: its value, when, and which bodies."""

    value: float
    step: int
    time: float  # s
    bodies: tuple[int, ...] = ()  # while the run goes on the ends of a contact: from n on they count planes
    planes: tuple[int, ...] = ()  # that a body touched, see `Moments.named`
    between: str = ""  # names of bodies and planes


NOTHING = Moment(0.0, 0, 0.0)


@dataclass(slots=True)
class Moments:
    """Extremes so far, of the steps whose energy was taken, or of all contacts; None where nothing was measured.

    Contacts dissipate and gravity is conservative, so the total energy can only fall. What it rises by, from its lowest
    value on, is somebody's fault, whether the ledger has an entry for it or not.
    """

    energy_error: Moment | None = None  # |integration error| / scale
    energy_gain: Moment = NOTHING  # rise of the total energy from its lowest so far / scale
    contact_gain: Moment = NOTHING  # what impulses of contacts gave back of what they took, or more / scale
    kinetic: Moment = NOTHING  # kinetic energy / scale: of the last step, not the largest
    impact: Moment | None = None  # J, largest ½ μ v_n² of a contact that was closing
    overlap: Moment | None = None  # deepest overlap / smaller radius
    contacts: Moment | None = None  # most contacts in a step
    momentum_error: Moment | None = NOTHING  # None where the scene does not conserve it
    angular_momentum_error: Moment | None = NOTHING  # likewise
    total_contacts: int = 0  # contact-steps: contacts, summed over the steps
    impacts: int = 0  # those on the way through a step each; those found at its end once a contact and step
    lowest_energy: float = float("inf")  # J
    energy_scale: float = 0.0  # J, of the last step
    most_taken: float = 0.0  # J, the largest restitution + friction of the ledger
    warned: tuple[str, ...] = ()  # kinds of warnings given so far

    @property
    def energy_fault(self) -> Moment | None:
        """The larger of the integration error and of what impulses of contacts put in: none of it may be."""
        if self.energy_error is None or self.contact_gain.value > self.energy_error.value:
            return self.contact_gain if self.contact_gain.value > 0.0 else self.energy_error
        return self.energy_error

    def see_contacts(self, step: int, time: float, tally: Tally) -> None:
        """Take note of a step's contacts."""
        self.impact = _larger(self.impact, tally.hardest, tally.hardest_pair, step, time)
        self.overlap = _larger(self.overlap, tally.deepest, tally.deepest_pair, step, time)
        if self.contacts is None or tally.contacts > self.contacts.value:
            self.contacts = Moment(float(tally.contacts), step, time)
        self.total_contacts += tally.contacts
        self.impacts += tally.impacts

    def named(self, names: Names) -> Moments:
        """Return the same extremes with planes told from bodies, and both by their names."""
        found: dict[str, Any] = {field.name: getattr(self, field.name) for field in fields(self)}
        for name, value in found.items():
            if isinstance(value, Moment):
                found[name] = _named(value, names)
        return Moments(**found)

    def highlights(self, names: Names) -> tuple[Event, ...]:
        """Put the extremes of contacts and energy into words, in order of time."""
        known = self.named(names)
        wordings = (
            (known.impact, "Hardest impact of the run, {value:.4g} J of approach (½ μ v_n²)"),
            (known.overlap, "Deepest overlap of the run, {value:.3%} of the smaller radius"),
            (known.contacts, "Most contacts of the run, {value:.0f}"),
            (known.energy_error, "Largest integration error of the run, {value:.2e} of the energy scale"),
        )
        events = []
        for moment, wording in wordings:
            if moment is not None and moment.value > 0:
                text = wording.format(value=moment.value) + (f": {moment.between}." if moment.between else ".")
                events.append(Event(moment.step, moment.time, "INFO", text, "extreme"))
        return tuple(sorted(events, key=lambda event: event.step))

    def see_energy(self, step: int, time: float, energy: Energy) -> None:
        """Take note of the energy of a step."""
        self.energy_error = _worse(self.energy_error, energy.relative_error, step, time)
        self.energy_scale = energy.scale
        self.lowest_energy = min(self.lowest_energy, energy.total)
        gain = energy.relative(energy.total - self.lowest_energy)
        if gain > self.energy_gain.value:
            self.energy_gain = Moment(gain, step, time)
        taken = energy.ledger.restitution + energy.ledger.friction
        self.most_taken = max(self.most_taken, taken)
        given = max(self.most_taken - taken, -energy.ledger.restitution, -energy.ledger.friction)
        if energy.relative(given) > self.contact_gain.value:
            self.contact_gain = Moment(energy.relative(given), step, time)
        self.kinetic = Moment(energy.relative(energy.translational + energy.rotational), step, time)

    def see_warning(self, kind: str) -> None:
        """Take note that a warning was given."""
        if kind not in self.warned:
            self.warned += (kind,)

    def see_momentum(self, step: int, time: float, momentum: Momentum) -> None:
        """Take note of the momenta of a step."""
        linear, angular = momentum.linear_error, momentum.angular_error
        self.momentum_error = None if linear is None else _worse(self.momentum_error, linear, step, time)
        self.angular_momentum_error = (
            None if angular is None else _worse(self.angular_momentum_error, angular, step, time)
        )


def _named(moment: Moment, names: Names) -> Moment:
    n = len(names.bodies)
    return replace(
        moment,
        bodies=tuple(end for end in moment.bodies if end < n),
        planes=tuple(end - n for end in moment.bodies if end >= n),
        between=" and ".join(names.of(end) for end in moment.bodies),
    )


def _worse(known: Moment | None, value: float, step: int, time: float) -> Moment:
    return known if known is not None and value <= known.value else Moment(value, step, time)


def _larger(known: Moment | None, value: float, pair: tuple[int, int], step: int, time: float) -> Moment:
    return known if known is not None and value <= known.value else Moment(value, step, time, pair)
