"""The impacts of a step that happened at their own times: their records, and the arrays that are read from them.

`events` writes the records; forces, statistics and the contact table read them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from carom.arrays import FloatArray, IntArray, Records
from carom.physics.contact.rolling import ANGULAR_IMPULSE
from carom.physics.diagnostics.ledger import TERMS, terms_of

ROUNDING = 1e-14  # of the speed of a body, and of a radius per drift; slower closing is rounding

IMPACT = np.dtype(
    [
        ("i", np.int64),  # i < j
        ("j", np.int64),
        ("time", np.float64),  # s from the beginning of the drift
        ("clock", np.float64),  # s, the time σ of the straight paths, see `events.trajectories`
        ("nx", np.float64),  # the normal, from i to j
        ("ny", np.float64),
        ("nz", np.float64),
        ("approach", np.float64),  # m/s, closing speed
        ("rest_speed", np.float64),  # m/s, closing speed up to which a contact is at rest
        *((term, np.float64) for term in TERMS),  # J
        ("vix", np.float64),  # m/s, velocities right after it
        ("viy", np.float64),
        ("viz", np.float64),
        ("vjx", np.float64),
        ("vjy", np.float64),
        ("vjz", np.float64),
        ("normal_impulse", np.float64),  # N s
        ("friction_x", np.float64),  # N s, the tangential impulse that acts on j
        ("friction_y", np.float64),
        ("friction_z", np.float64),
        ("arm_i", np.float64),  # m, from each centre to the contact point
        ("arm_j", np.float64),
        ("x", np.float64),  # m, the contact point
        ("y", np.float64),
        ("z", np.float64),
    ]
)
ROLLING_IMPACT = np.dtype([*IMPACT.descr, *((name, np.float64) for name in ANGULAR_IMPULSE)])  # N m s, with torques


@dataclass(frozen=True, slots=True)
class Impacts:
    """The impacts of a drift, in the order of time."""

    pairs: IntArray  # (k, 2), i < j
    time: FloatArray  # (k,) s from the beginning of the drift
    normal: FloatArray  # (k, 3) from i to j
    approach: FloatArray  # (k,) m/s
    rest_speed: FloatArray  # (k,) m/s, of each impact
    ledger: FloatArray  # (k, 3) J
    after: FloatArray  # (k, 2, 3) m/s, velocities of both right after it
    log: Records  # (k,) `IMPACT`, the source of the other fields

    def __len__(self) -> int:
        return len(self.pairs)

    def followed_by(self, later: Impacts) -> Impacts:
        """Add later impacts."""
        return Impacts.of(np.concatenate((self.log, later.log))) if len(self) else later

    @classmethod
    def of(cls, log: Records) -> Impacts:
        """Read a log, (k,) `IMPACT`."""
        after = _columns(log, "vix", "viy", "viz", "vjx", "vjy", "vjz")
        return cls(
            pairs=_columns(log, "i", "j"),
            time=log["time"],
            normal=_columns(log, "nx", "ny", "nz"),
            approach=log["approach"],
            rest_speed=log["rest_speed"],
            ledger=terms_of(log),
            after=after.reshape(-1, 2, 3),
            log=log,
        )


def _columns(records: Records, *names: str) -> NDArray[Any]:
    """Return fields of records side by side, (k, number of names)."""
    return np.stack([records[name] for name in names], axis=-1)


NO_IMPACTS = Impacts.of(np.empty(0, dtype=IMPACT))
