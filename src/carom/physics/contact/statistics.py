"""Contact statistics of a step: numbers, hardest impact, deepest overlap, energies, and limits that the step reached.

Statistics are computed in every step, block by block, from the records of the solver. The graph of the contacts is
built only on demand (`snapshot`).
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple, Protocol, cast

import numpy as np

from carom.arrays import FloatArray, IntArray, RecordArray, dtype_of
from carom.physics.bodies import Ends
from carom.physics.contact.constraints import CONTACTS_PER_BLOCK, ends_of
from carom.physics.contact.graph import OVERFLOW, OrderedContacts, comes_before, first_of
from carom.physics.contact.impact_log import Impacts
from carom.physics.contact.records import ContactRecord, ContactStateRecord, ImpactRecord
from carom.physics.diagnostics.ledger import LedgerRecord, clear_terms, terms_of
from carom.physics.jit.decorators import inline, kernel, long_kernel
from carom.physics.jit.instructions import from_front
from carom.physics.jit.team import Team
from carom.scene.schema import ContactSettings

MIN_BLOCKS_PER_TASK = 2


class BlockCountsRecord(LedgerRecord, Protocol):
    """Statistics of one block of contacts."""

    contacts: float  # number of contacts; the next field has the number of impacts
    impacts: float
    struck: float  # J, Σ ½ μ v_n² over the impacts
    hardest: float  # J
    hardest_i: float  # ends of the hardest impact
    hardest_j: float
    deepest: float  # deepest overlap, divided by the smaller radius
    deepest_i: float  # ends of the deepest overlap
    deepest_j: float


BLOCK_COUNTS = dtype_of(BlockCountsRecord)


class ContactStatistics(NamedTuple):
    """Statistics of a step's contacts that touch or carry an impulse, and the work of all contacts."""

    work: FloatArray  # (k, 3) J, energies of each block of contacts by entry of the ledger
    contacts: int
    # number of impacts in the drift, and of contacts at the end of the step that close faster than the rest speed
    impacts: int
    struck: float  # J, Σ ½ μ v_n² over the counted impacts
    hardest: float  # J, energy of the hardest impact; 0 without impacts
    hardest_pair: tuple[int, int]  # ends of the hardest impact, or of the first of equally hard ones
    deepest: float  # overlap / smaller radius
    deepest_pair: tuple[int, int]

    @classmethod
    def of(
        cls,
        pairs: IntArray,
        contacts: RecordArray[ContactRecord],
        states: RecordArray[ContactStateRecord],
        ends: Ends,
        team: Team,
    ) -> ContactStatistics:
        """Return the statistics of contacts; for the arrays, see `ConstraintSystem`."""
        blocks = np.empty(-(-len(pairs) // CONTACTS_PER_BLOCK), BLOCK_COUNTS)
        counted = (pairs, contacts, states, ends.inverse_mass, ends.radius, blocks)
        team.divide(len(blocks), MIN_BLOCKS_PER_TASK, count_block, *counted)
        totals = blocks
        if len(blocks) != 1:
            totals = np.empty(1, BLOCK_COUNTS)
            _add_up(blocks, totals)
        total = dict(zip(BLOCK_COUNTS.names or (), totals[0].item(), strict=True))
        if total["contacts"] == 0.0:
            return NO_CONTACTS._replace(work=terms_of(blocks))
        return cls(
            work=terms_of(blocks),
            contacts=int(total["contacts"]),
            impacts=int(total["impacts"]),
            struck=total["struck"],
            hardest=total["hardest"],
            hardest_pair=(int(total["hardest_i"]), int(total["hardest_j"])) if total["impacts"] else (0, 0),
            deepest=total["deepest"],
            deepest_pair=(int(total["deepest_i"]), int(total["deepest_j"])),
        )

    def plus(self, others: ContactStatistics) -> ContactStatistics:
        """Add contacts of other pairs that are not impacts."""
        mine, theirs = (self.deepest, self.deepest_pair), (others.deepest, others.deepest_pair)
        first = max(mine, theirs, key=lambda overlap: (overlap[0], -overlap[1][0], -overlap[1][1]))
        return self._replace(contacts=self.contacts + others.contacts, deepest=first[0], deepest_pair=first[1])

    def with_impacts(
        self,
        impacts: Impacts,
        ordered: OrderedContacts,
        contacts: RecordArray[ContactRecord],
        states: RecordArray[ContactStateRecord],
        inverse_mass: FloatArray,
    ) -> ContactStatistics:
        """Add the impacts during the drift of a step; a pair counts as one contact, with its hardest impact.

        These statistics describe the contacts at the end of the step, with arrays as in `ConstraintSystem`.
        """
        log, place = impacts.log, ordered.order.place
        order = np.argsort(log["i"] * len(inverse_mass) + log["j"], kind="stable")
        further, energy, hardest, i, j = _add_impacts(
            cast(RecordArray[ImpactRecord], log), order, ordered.pairs, place, contacts, states, inverse_mass
        )
        mine, theirs = (self.hardest, self.hardest_pair), (hardest, (i, j))
        first = max(mine, theirs, key=lambda impact: (impact[0], -impact[1][0], -impact[1][1]))
        deepest_pair = self.deepest_pair
        if self.deepest == 0.0 and len(log) > 0:  # if no pair overlaps, name the first pair that touched
            touching = int(log["i"][order[0]]), int(log["j"][order[0]])
            deepest_pair = touching if self.contacts == 0 else min(touching, deepest_pair)
        return self._replace(
            work=np.concatenate((impacts.ledger, self.work)),
            contacts=self.contacts + further,
            impacts=self.impacts + int(np.count_nonzero(impacts.approach > impacts.rest_speed)),
            struck=self.struck + energy,
            hardest=first[0],
            hardest_pair=first[1],
            deepest_pair=deepest_pair,
        )


NO_CONTACTS = ContactStatistics(np.zeros((0, 3)), 0, 0, 0.0, 0.0, (0, 0), 0.0, (0, 0))


@long_kernel
def count_block(
    lo: int,
    hi: int,
    pairs: IntArray,
    contacts: RecordArray[ContactRecord],
    states: RecordArray[ContactStateRecord],
    inverse_mass: FloatArray,
    radius: FloatArray,
    blocks: RecordArray[BlockCountsRecord],
) -> None:
    """Compute the statistics of the blocks [lo, hi) of contacts."""
    for k in range(lo, hi):
        block = blocks[k]
        _begin(block)
        restitution, friction, stabilisation = 0.0, 0.0, 0.0
        count, impacts, struck = 0, 0, 0.0
        for c in range(from_front(k * CONTACTS_PER_BLOCK), min(len(pairs), (k + 1) * CONTACTS_PER_BLOCK)):
            state = states[c]
            restitution += state.restitution_loss
            friction += state.friction_loss
            stabilisation += state.stabilisation_gain
            if state.apart and contacts[c].normal_impulse <= 0.0:
                continue
            (i, j), approach = ends_of(pairs, c), state.approach_speed
            count += 1
            if approach > state.rest_speed:
                energy = 0.5 * approach * approach / (inverse_mass[i] + inverse_mass[j])
                impacts += 1
                struck += energy
                _keep_hardest(block, energy, i, j)
            _keep_deepest(block, state.detected_overlap / min(radius[i], radius[j]), i, j)
        block.restitution_loss, block.friction_loss, block.stabilisation_gain = restitution, friction, stabilisation
        block.contacts, block.impacts, block.struck = count, impacts, struck


@kernel
def _add_impacts(
    log: RecordArray[ImpactRecord],
    order: IntArray,
    known: IntArray,
    place: IntArray,
    contacts: RecordArray[ContactRecord],
    states: RecordArray[ContactStateRecord],
    inverse_mass: FloatArray,
) -> tuple[int, float, float, int, int]:
    """Add impacts; ``order`` has their indices, sorted by pair and then by time.

    Return the number of pairs without a contact at the end; the sum of the energies (J) of the pairs' hardest impacts,
    without energies that are already counted for contacts at the end; and the energy and ends of the hardest impact.
    """
    further, energy, hardest, hardest_i, hardest_j = 0, 0.0, 0.0, 0, 0
    row = 0
    while row < len(order):
        i, j, first = from_front(log[order[row]].i), from_front(log[order[row]].j), row
        while row < len(order) and log[order[row]].i == i and log[order[row]].j == j:
            first = row if log[order[row]].approach > log[order[first]].approach else first
            row += 1
        speed, limit, counted = log[order[first]].approach, log[order[first]].rest_speed, 0.0
        twice = 2.0 * (inverse_mass[i] + inverse_mass[j])
        c = first_of(i, known)
        while c < len(known) and known[c, 0] == i and known[c, 1] < j:
            c += 1
        is_known = c < len(known) and known[c, 0] == i and known[c, 1] == j
        if is_known:
            state = states[place[c]]
            is_known = not state.apart or contacts[place[c]].normal_impulse > 0.0
            if is_known:
                late, limit = state.approach_speed, state.rest_speed
                counted = late * late / twice if late > limit else 0.0
                speed = max(speed, late)
        if not is_known:
            further += 1
        if speed > limit:
            struck = speed * speed / twice
            energy += struck - counted
            if _comes_first(struck, i, j, hardest, hardest_i, hardest_j):
                hardest, hardest_i, hardest_j = struck, i, j
    return further, energy, hardest, hardest_i, hardest_j


@inline
def _begin(block: BlockCountsRecord) -> None:
    clear_terms(block)
    block.contacts = block.impacts = block.struck = block.hardest = block.deepest = 0.0
    block.hardest_i = block.hardest_j = block.deepest_i = block.deepest_j = np.inf


@kernel
def _add_up(blocks: RecordArray[BlockCountsRecord], totals: RecordArray[BlockCountsRecord]) -> None:
    total = totals[0]
    _begin(total)
    for k in range(len(blocks)):
        block = blocks[k]
        total.contacts += block.contacts
        total.impacts += block.impacts
        total.struck += block.struck
        _keep_hardest(total, block.hardest, block.hardest_i, block.hardest_j)
        _keep_deepest(total, block.deepest, block.deepest_i, block.deepest_j)


@inline
def _keep_hardest(block: BlockCountsRecord, energy: float, i: float, j: float) -> None:
    if _comes_first(energy, i, j, block.hardest, block.hardest_i, block.hardest_j):
        block.hardest, block.hardest_i, block.hardest_j = energy, i, j


@inline
def _keep_deepest(block: BlockCountsRecord, depth: float, i: float, j: float) -> None:
    if _comes_first(depth, i, j, block.deepest, block.deepest_i, block.deepest_j):
        block.deepest, block.deepest_i, block.deepest_j = depth, i, j


@inline
def _comes_first(value: float, i: float, j: float, largest: float, first: float, second: float) -> bool:
    """Return whether a value is larger than the largest so far, or equal but from an earlier pair."""
    return value > largest or (value == largest and comes_before(i, j, first, second))


DEEP_OVERLAP = 0.1  # overlap above which a run warns, in smaller radii; rigid spheres do not overlap at all
OVERLAPS = f"Bodies overlap by more than {DEEP_OVERLAP:.0%} of the smaller radius"


def limits_of(
    contact: ContactSettings,
    *,
    serial_stage: bool,  # whether contacts need more colours than there are parallel stages
    too_few_sweeps: bool,  # whether contacts were still closing after the sweeps
    of_parts: Iterable[str],  # warnings of optional parts
    deepest: float,  # overlap / smaller radius
) -> list[tuple[str, str]]:
    """Return the limits of the method that a step reached: level, `WARN` or `INFO`, and text."""
    reached = []
    if serial_stage:  # the serial stage only costs time
        text = f"More than {OVERFLOW} colours are needed: the remaining contacts are resolved in a last, serial stage."
        reached.append(("INFO", text))
    if too_few_sweeps:
        reached.append(("WARN", still_closing(contact)))
    reached += [("WARN", text) for text in of_parts]
    if deepest > DEEP_OVERLAP and not contact.allow_overlap:
        more = " or more sweeps (contact.sweeps)" if contact.sweeps not in ("auto", "converged") else ""
        text = f"{OVERLAPS}; try a shorter step (time.fixed_dt, time.cfl){more}."
        reached.append(("WARN", text))
    return reached


def still_closing(contact: ContactSettings) -> str:
    """Return the warning about too few sweeps."""
    return (
        f"Contacts were still closing after the sweeps of a step (contact.sweeps = {contact.sweeps}); "
        "the remainder is resolved in later steps."
    )
