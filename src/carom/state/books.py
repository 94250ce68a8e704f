"""The books of a run: totals, extremes and reference values so far. Steps do not depend on the books."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from operator import attrgetter
from typing import Any

from carom.contact_table import ROUNDED_OVERLAP
from carom.event import Event
from carom.scene.units.dimension import ENERGY
from carom.scene.units.system import UnitSystem
from carom.scene.wording import Names
from carom.state.energies import Energy, EnergyBaseline


@dataclass(frozen=True, slots=True)
class Extreme:
    """One extreme: its value, its time, and the bodies involved."""

    value: float
    step: int
    time: float  # s
    bodies: tuple[int, ...] = ()  # numbers of both ends of a contact, during the run; numbers ≥ n are planes
    planes: tuple[int, ...] = ()  # planes involved, see `Extremes.named`
    between: str = ""  # names of bodies and planes


NOTHING = Extreme(0.0, 0, 0.0)


@dataclass(slots=True)
class Extremes:
    """Extremes so far: of energy and momentum at the checks, of contacts at every step.

    An extreme is None if it was not measured. Contacts dissipate and gravity is conservative, so the total energy can
    only fall. A rise above its lowest value is an error, whether or not the ledger explains it.
    """

    energy_error: Extreme | None = None  # |integration error| / scale
    energy_gain: Extreme = NOTHING  # largest rise of the total energy above its previous minimum, relative to the scale
    contact_gain: Extreme = NOTHING  # energy that contact impulses added or gave back, relative to the scale
    kinetic: Extreme = NOTHING  # kinetic energy at the last check (not the largest), relative to the scale
    impact: Extreme | None = None  # J, largest ½ μ v_n² of any impact
    overlap: Extreme | None = None  # deepest overlap, relative to the smaller radius
    contacts: Extreme | None = None  # largest number of contacts in a step
    momentum_error: Extreme | None = NOTHING  # None if the scene does not conserve momentum
    angular_momentum_error: Extreme | None = NOTHING  # None if the scene does not conserve angular momentum
    total_contacts: int = 0  # sum of the numbers of contacts over the steps
    impacts: int = 0  # number of impacts: each during a drift, and one for each contact at the end of a step
    lowest_energy: float = float("inf")  # J, lowest total energy so far
    energy_scale: float = 0.0  # J, energy scale at the last check
    most_taken: float = 0.0  # J, largest restitution + friction in the ledger
    warned: tuple[str, ...] = ()  # kinds of warnings so far
    contact_audit: Extreme | None = None  # largest error of `diagnostics.impulse_audit`; None if there is no audit
    dissipation_error: Extreme | None = None  # wrong work found by `diagnostics.dissipation`, relative to the scale

    @property
    def energy_fault(self) -> Extreme | None:
        """The larger of the integration error and the energy added by contact impulses; both are errors."""
        if self.energy_error is None or self.contact_gain.value > self.energy_error.value:
            return self.contact_gain if self.contact_gain.value > 0.0 else self.energy_error
        return self.energy_error

    def copy(self) -> Extremes:
        """Return a copy, which later steps do not change."""
        return Extremes(*_values(self))

    def named(self, names: Names) -> Extremes:
        """Return the extremes with separate numbers of bodies and planes, and with their names."""
        n = len(names.bodies)

        def named(extreme: Extreme) -> Extreme:
            return replace(
                extreme,
                bodies=tuple(end for end in extreme.bodies if end < n),
                planes=tuple(end - n for end in extreme.bodies if end >= n),
                between=names.pair(extreme.bodies),
            )

        values: list[Any] = [named(value) if isinstance(value, Extreme) else value for value in _values(self)]
        return Extremes(*values)

    def highlights(
        self, names: Names, units: UnitSystem, energy_error: str = "integration error at a check"
    ) -> tuple[Event, ...]:
        """Return the extremes of contacts and energy as events in order of time; ``energy_error`` names the error."""
        known = self.named(names)
        overlap = known.overlap if known.overlap and known.overlap.value > ROUNDED_OVERLAP else None
        deepest = 0.0 if overlap is None else 100.0 * overlap.value
        approach = "" if known.impact is None else units.text(known.impact.value, ENERGY, ".4g")
        wordings = (
            (known.impact, f"Hardest impact of the run, {approach} of approach (½ μ v_n²)"),
            (overlap, f"Deepest overlap of the run, {deepest:.3g}% of the smaller radius"),
            (known.contacts, "Most contacts of the run, {value:.0f}"),
            (known.energy_error, f"Largest {energy_error}, {{value:.2e}} of the energy scale"),
        )
        events = []
        for extreme, wording in wordings:
            if extreme is not None and extreme.value > 0:
                text = wording.format(value=extreme.value) + (f": {extreme.between}." if extreme.between else ".")
                events.append(Event(extreme.step, extreme.time, "INFO", text, "extreme"))
        return tuple(sorted(events, key=lambda event: event.step))

    def add_warning(self, kind: str) -> None:
        """Update the kinds of warnings so far."""
        if kind not in self.warned:
            self.warned += (kind,)


_values: Callable[[Extremes], tuple[Any, ...]] = attrgetter(*(field.name for field in fields(Extremes)))


@dataclass(frozen=True, slots=True)
class MomentumBaseline:
    """Reference values: the initial momenta, and the largest sums of magnitudes at the checks so far."""

    linear: tuple[float, float, float]  # kg m/s, initial momentum
    angular: tuple[float, float, float]  # kg m²/s, initial angular momentum
    centre: tuple[float, float, float]  # m, position of the centre of mass
    linear_scale: float  # kg m/s
    angular_scale: float  # kg m²/s


@dataclass(frozen=True, slots=True)
class MonitorState:
    """The state of the energy monitor between two checks."""

    lowest: Energy | None = None  # lowest total energy since the last warning
    since: float = 0.0  # s, time of the lowest total energy
    warnings: int = 0
    lost: bool = False  # whether the loss of a large part of the energy has been reported
    gained: bool = False  # whether energy added by contact impulses has been reported


@dataclass(frozen=True, slots=True)
class PaceTally:
    """The state of the pace monitor between two checks."""

    # s, start of the present series of short steps; None if the last step was not short
    slow_since: float | None = None
    told: bool = False  # whether the warning about short steps has been given


@dataclass(frozen=True, slots=True)
class WrongWork:
    """A row of the tally of wrong work, for a checkpoint."""

    energy: float  # J
    worst: float  # J
    pair: tuple[int, int]
    step: int
    time: float  # s
    told: bool  # whether the warning of this row has been given


@dataclass(frozen=True, slots=True)
class Books:
    """Running totals and extremes of a run. The summary and the warnings depend on the books; steps do not."""

    energy: EnergyBaseline
    momentum: MomentumBaseline
    watch: MonitorState
    moments: Extremes
    activity: float  # J, energy of the impacts in the last steps
    phase: str
    limits: tuple[str, ...]  # limits of the method that were reached and reported so far
    pace: PaceTally
    wrong_work: tuple[WrongWork, ...] = ()  # violations found by `diagnostics.dissipation`; empty if there were none
