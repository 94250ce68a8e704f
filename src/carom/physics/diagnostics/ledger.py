"""The energy ledger: energy that contacts and forces removed from the bodies or added to them, by term.

Kernels write each term of a contact into the field with the term's name. Arrays of all terms have one column per term,
in the order of the fields.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np

from carom.arrays import FloatArray, RecordArray
from carom.physics.aligned import columns
from carom.physics.jit.decorators import inline, kernel
from carom.state.energies import Ledger

RESTITUTION, FRICTION, STABILISATION = range(3)  # columns of arrays of terms, (m, 3) J


class LedgerRecord(Protocol):
    """A record with the terms of the ledger as fields."""

    restitution_loss: float  # J
    friction_loss: float
    stabilisation_gain: float


TERMS = tuple(LedgerRecord.__annotations__)


def terms_of(records: RecordArray[LedgerRecord]) -> FloatArray:
    """Return the ledger terms of records, (m, 3) J, as a view."""
    return columns(records, TERMS)


@inline
def clear_terms(entry: LedgerRecord) -> None:
    """Set the terms of a record to 0."""
    entry.restitution_loss = entry.friction_loss = entry.stabilisation_gain = 0.0


@inline
def copy_terms(entry: LedgerRecord, to: LedgerRecord) -> None:
    """Copy the terms of a record to another record."""
    to.restitution_loss, to.friction_loss = entry.restitution_loss, entry.friction_loss
    to.stabilisation_gain = entry.stabilisation_gain


def with_contacts(ledger: Ledger, contacts: FloatArray) -> Ledger:
    """Return the ledger after a step, given the energies of its contacts, (m, 3) J."""
    step = np.zeros(3)
    _sum_rows(contacts, step)
    return Ledger(
        ledger.restitution + float(step[RESTITUTION]),
        ledger.friction + float(step[FRICTION]),
        ledger.stabilisation + float(step[STABILISATION]),
        ledger.forces,
    )


@kernel
def _sum_rows(rows: FloatArray, total: FloatArray) -> None:
    for c in range(len(rows)):
        for k in range(3):
            total[k] += rows[c, k]
