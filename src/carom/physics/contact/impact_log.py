"""The impacts of a step that were resolved at their exact times, as records and arrays.

`events` writes the records; forces, statistics and the contact table use them.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import cast

import numpy as np

from carom.arrays import FloatArray, IntArray, Records, dtype_of
from carom.physics.aligned import columns
from carom.physics.contact.records import ImpactRecord, RollingImpactRecord
from carom.physics.diagnostics.ledger import terms_of

ROUNDING = 1e-14  # relative to a body's speed, and to one radius per drift: a slower approach is rounding
MAX_IN_COLLAPSE = 100  # impacts in a drift after which a body is held, where e < 1 and no force presses
# Number of impacts of a body in a drift after which it rattles among others that press it, though no contact has yet
# carried a load: with e < 1, its slow impacts then end at the load speed. Without this, bodies in the densest steps of
# `hopper` have 1300 impacts instead of 160 and are exhausted.
MANY_IMPACTS = 30


IMPACT = dtype_of(ImpactRecord)
ROLLING_IMPACT = dtype_of(RollingImpactRecord)


@dataclass(frozen=True)
class Impacts:
    """The impacts of a drift, in the order of time.

    Most steps need only the log, so arrays with several columns are made on demand.
    """

    log: Records  # (k,) `IMPACT`

    def __len__(self) -> int:
        return len(self.log)

    def followed_by(self, later: Impacts) -> Impacts:
        """Add later impacts."""
        return Impacts(np.concatenate((self.log, later.log))) if len(self) else later

    @cached_property
    def pairs(self) -> IntArray:
        """(k, 2), i < j."""
        return np.stack((self.log["i"], self.log["j"]), axis=1)

    @property
    def time(self) -> FloatArray:
        """(k,) s from the beginning of the drift."""
        return cast(FloatArray, self.log["time"])

    @property
    def normal(self) -> FloatArray:
        """(k, 3) from i to j."""
        return columns(self.log, ("nx", "ny", "nz"))

    @property
    def approach(self) -> FloatArray:
        """(k,) m/s."""
        return cast(FloatArray, self.log["approach"])

    @property
    def rest_speed(self) -> FloatArray:
        """(k,) m/s, of each impact."""
        return cast(FloatArray, self.log["rest_speed"])

    @property
    def ledger(self) -> FloatArray:
        """(k, 3) J."""
        return terms_of(self.log)

    @cached_property
    def after(self) -> FloatArray:
        """(k, 2, 3) m/s, velocities of both bodies right after the impact."""
        return columns(self.log, ("vix", "viy", "viz", "vjx", "vjy", "vjz")).reshape(-1, 2, 3)


NO_IMPACTS = Impacts(np.empty(0, dtype=IMPACT))
