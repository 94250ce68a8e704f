"""Updates the extremes of a run from the contacts of every step, and from energy and momentum at the checks."""

from __future__ import annotations

from carom.physics.contact.statistics import ContactStatistics
from carom.physics.diagnostics.momentum import Momentum
from carom.state.books import Extreme, Extremes
from carom.state.energies import Energy


def add_contacts(extremes: Extremes, step: int, time: float, tally: ContactStatistics) -> None:
    """Update the extremes with the contacts of a step."""
    if tally.impacts:
        extremes.impact = _larger(extremes.impact, tally.hardest, step, time, tally.hardest_pair)
    extremes.overlap = _larger(extremes.overlap, tally.deepest, step, time, tally.deepest_pair)
    if extremes.contacts is None or tally.contacts > extremes.contacts.value:
        extremes.contacts = Extreme(float(tally.contacts), step, time)
    extremes.total_contacts += tally.contacts
    extremes.impacts += tally.impacts


def add_energy(extremes: Extremes, step: int, time: float, energy: Energy) -> None:
    """Update the extremes with the energy of a step."""
    undamped, ledger = energy.undamped, energy.ledger
    extremes.energy_error = _larger(extremes.energy_error, energy.relative_error, step, time)
    extremes.energy_scale = energy.scale
    extremes.lowest_energy = min(extremes.lowest_energy, undamped)
    gain = energy.relative_change(undamped - extremes.lowest_energy)
    if gain > extremes.energy_gain.value:
        extremes.energy_gain = Extreme(gain, step, time)
    taken = ledger.restitution + ledger.friction
    extremes.most_taken = max(extremes.most_taken, taken)
    given = energy.relative_change(max(extremes.most_taken - taken, -ledger.restitution, -ledger.friction))
    if given > extremes.contact_gain.value:
        extremes.contact_gain = Extreme(given, step, time)
    extremes.kinetic = Extreme(energy.relative(energy.translational + energy.rotational), step, time)


def add_impulse_audit(extremes: Extremes, step: int, time: float, worst: tuple[float, tuple[int, ...]]) -> None:
    """Update the extremes with the largest error of a step's impulses, and the body that has it."""
    error, bodies = worst
    if extremes.contact_audit is None or not error <= extremes.contact_audit.value:
        extremes.contact_audit = Extreme(error, step, time, bodies)


def add_momentum(extremes: Extremes, step: int, time: float, momentum: Momentum) -> None:
    """Update the extremes with the momenta of a step."""
    linear, angular = momentum.linear_error, momentum.angular_error
    extremes.momentum_error = None if linear is None else _larger(extremes.momentum_error, linear, step, time)
    extremes.angular_momentum_error = (
        None if angular is None else _larger(extremes.angular_momentum_error, angular, step, time)
    )


def _larger(known: Extreme | None, value: float, step: int, time: float, pair: tuple[int, ...] = ()) -> Extreme:
    return known if known is not None and value <= known.value else Extreme(value, step, time, pair)
