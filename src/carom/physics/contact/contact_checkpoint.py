"""The state of lasting contacts that the next step needs."""

from __future__ import annotations

from dataclasses import dataclass

from carom.arrays import FloatArray, IntArray


@dataclass(frozen=True, slots=True)
class SleepCheckpoint:
    """Which bodies sleep, and their contacts. Its arrays are never written to."""

    calm: FloatArray  # (n,) s, how long each body has been slow; -1 if it sleeps
    reference: FloatArray  # (n, 3) m/s², accelerations of the sleepers when they fell asleep
    pairs: IntArray  # (k, 2) of sleepers and fixed ends, sorted
    force: FloatArray  # (k, 4) N, along the normal and tangential


@dataclass(frozen=True, slots=True)
class ContactCheckpoint:
    """The contacts of a step that the next step needs, and the impulses of the last kick.

    Its arrays are never written to.
    """

    pairs: IntArray  # (m, 2), sorted; includes near contacts
    rest_speed: FloatArray  # (m,) m/s, closing speed up to which a contact is at rest
    load_speed: FloatArray  # (m,) m/s, see `ConstraintSystem`
    dt: float  # s, the step for which these speeds were computed
    held_pairs: IntArray  # (k, 2), sorted; usually the same as ``pairs``
    impulse: FloatArray  # (k, 4) N s: λ_n, λ_t; (k, 7) where the law resists rolling, with Λ in N m s
    kick: float  # s, length of that kick
    sleep: SleepCheckpoint | None = None  # None where no body can sleep
    # (3,) of the piston: displacement in m, velocity in m/s, impulse of the bodies on it in N s; None without one
    piston: FloatArray | None = None

    @property
    def highest(self) -> int:
        """The highest index of a body or plane in a contact, or -1 without contacts."""
        slept = self.held_pairs[:0] if self.sleep is None else self.sleep.pairs
        return max((int(pairs.max()) for pairs in (self.pairs, self.held_pairs, slept) if len(pairs)), default=-1)
