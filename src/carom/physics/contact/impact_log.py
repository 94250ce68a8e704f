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

ROUNDING = 1e-14  # closing speed that counts as rounding, relative to a body's speed and to one radius per drift
MAX_IN_COLLAPSE = 100  # impacts in a drift after which a body is held, if e < 1 and no force presses
# Number of impacts of a body in a drift after which it counts as rattling between bodies that press it, even if no
# contact has yet carried a load. With e < 1, impacts of a rattling body slower than the load speed do not rebound.
# Without this limit, bodies in the densest steps of `hopper` have 1300 impacts instead of 160 and are exhausted.
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
        """Pairs of bodies, (k, 2), with i < j."""
        return np.stack((self.log["i"], self.log["j"]), axis=1)

    @property
    def time(self) -> FloatArray:
        """Times of the impacts, (k,) s from the beginning of the drift."""
        return cast(FloatArray, self.log["time"])

    @property
    def normal(self) -> FloatArray:
        """Normals from i to j, (k, 3)."""
        return columns(self.log, ("nx", "ny", "nz"))

    @property
    def approach(self) -> FloatArray:
        """Closing speeds, (k,) m/s."""
        return cast(FloatArray, self.log["approach"])

    @property
    def rest_speed(self) -> FloatArray:
        """Rest speed of each impact, (k,) m/s."""
        return cast(FloatArray, self.log["rest_speed"])

    @property
    def ledger(self) -> FloatArray:
        """Energy losses of each impact by entry of the ledger, (k, 3) J."""
        return terms_of(self.log)

    @cached_property
    def after(self) -> FloatArray:
        """Velocities of both bodies right after the impact, (k, 2, 3) m/s."""
        return columns(self.log, ("vix", "viy", "viz", "vjx", "vjy", "vjz")).reshape(-1, 2, 3)


NO_IMPACTS = Impacts(np.empty(0, dtype=IMPACT))
