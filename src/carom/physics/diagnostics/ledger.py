"""The energy ledger: energy that contacts and forces removed from the bodies or added to them, by term.

Kernels write each term of a contact into the field of its name. Arrays of all terms have one column per term, in this
order.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated, Protocol

import numpy as np

from carom.arrays import FloatArray, RecordArray
from carom.physics.aligned import columns
from carom.physics.jit.decorators import inline, kernel
from carom.physics.saved import Saved

RESTITUTION, FRICTION, STABILISATION = range(3)  # columns of (m, 3) arrays, J
NamedEnergies = tuple[tuple[str, float], ...]  # J, by entry of the ledger or term of the energy; hashable


class LedgerRecord(Protocol):
    """The terms as fields of records."""

    restitution_loss: float  # J
    friction_loss: float
    stabilisation_gain: float


TERMS = tuple(LedgerRecord.__annotations__)


@dataclass(frozen=True, slots=True)
class Ledger:
    """Energy moved by contacts, forces without a potential and moving walls since the start of the run, in joules.

    Contacts are summed from the impulses themselves. Dissipation is positive when energy leaves the bodies,
    stabilisation when it enters them.
    """

    restitution: Annotated[float, Saved("ledger_restitution", "J")] = 0.0  # removed by normal impulses
    friction: Annotated[float, Saved("ledger_friction", "J")] = 0.0  # removed by tangential impulses
    # added by pushing overlapping bodies apart (Baumgarte bias or split)
    stabilisation: Annotated[float, Saved("ledger_stabilisation", "J")] = 0.0
    # removed by forces without a potential and by moving walls, by entry
    forces: Annotated[NamedEnergies, Saved("ledger_", "J", is_named=True)] = ()

    def entry(self, name: str) -> float:
        """Return an entry by its name in the recording, in joules."""
        forces = dict(self.forces)
        return forces[name] if name in forces else float(getattr(self, name))

    def plus(self, contacts: FloatArray) -> Ledger:
        """Return the ledger after a step, given the energies of its contacts, (m, 3) J."""
        step = np.zeros(3)
        _sum_rows(contacts, step)
        return Ledger(
            self.restitution + float(step[RESTITUTION]),
            self.friction + float(step[FRICTION]),
            self.stabilisation + float(step[STABILISATION]),
            self.forces,
        )

    def plus_loss(self, entry: str, loss: float) -> Ledger:
        """Return the ledger after a force without a potential removed ``loss`` joules."""
        return self.with_loss(entry, dict(self.forces).get(entry, 0.0) + loss)

    def with_loss(self, entry: str, loss: float) -> Ledger:
        """Return the ledger after a force without a potential removed ``loss`` joules in all."""
        return replace(self, forces=tuple({**dict(self.forces), entry: loss}.items()))

    @property
    def balance(self) -> float:
        """The energy that left the bodies minus the energy that entered them."""
        by_contacts = self.restitution + self.friction - self.stabilisation
        return by_contacts + self.by_forces if self.forces else by_contacts

    @property
    def by_forces(self) -> float:
        """The energy removed by forces without a potential; negative if a moving medium added more."""
        return sum(loss for _, loss in self.forces)

    @property
    def taken_out(self) -> float:
        """The energy removed by contacts; a negative entry, which is an error, counts as 0."""
        return max(0.0, self.restitution) + max(0.0, self.friction)


def terms_of(records: RecordArray[LedgerRecord]) -> FloatArray:
    """Return the ledger terms of records, (m, 3) J, as a view."""
    return columns(records, TERMS)


@inline
def clear_terms(entry: LedgerRecord) -> None:
    """Set the terms of a record to 0."""
    entry.restitution_loss = entry.friction_loss = entry.stabilisation_gain = 0.0


@inline
def copy_terms(entry: LedgerRecord, to: LedgerRecord) -> None:
    """Copy the terms of a record to another one."""
    to.restitution_loss, to.friction_loss = entry.restitution_loss, entry.friction_loss
    to.stabilisation_gain = entry.stabilisation_gain


@kernel
def _sum_rows(rows: FloatArray, total: FloatArray) -> None:
    for c in range(len(rows)):
        for k in range(3):
            total[k] += rows[c, k]
