"""The state of lasting contacts that the next step needs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from carom.arrays import FloatArray, IntArray
from carom.physics.saved import BODY, CONTACT, HELD, RUN, SLEEPING, Saved


@dataclass(frozen=True, slots=True)
class SleepCheckpoint:
    """Which bodies sleep, and their contacts. Its arrays are never written to."""

    # (n,) how long each body has been slow; -1 if it sleeps
    calm: Annotated[FloatArray, Saved("sleep_calm", "s", BODY)]
    # (n, 3) accelerations of the sleepers when they fell asleep
    reference: Annotated[FloatArray, Saved("sleep_reference", "m/s²", BODY, 3, is_squared=True)]
    # (k, 2) of sleepers and fixed ends, sorted
    pairs: Annotated[IntArray, Saved("sleep_pairs", "", SLEEPING, 2, is_pairs=True)]
    force: Annotated[FloatArray, Saved("sleep_force", "N", SLEEPING, 4)]  # (k, 4) along the normal and tangential


@dataclass(frozen=True, slots=True)
class ContactCheckpoint:
    """The contacts of a step that the next step needs, and the impulses of the last kick.

    Its arrays are never written to.
    """

    # (m, 2), sorted; includes near contacts
    pairs: Annotated[IntArray, Saved("contact_pairs", "", CONTACT, 2, is_pairs=True)]
    # (m,) closing speed up to which a contact is at rest
    rest_speed: Annotated[FloatArray, Saved("contact_rest_speed", "m/s", CONTACT)]
    load_speed: Annotated[FloatArray, Saved("contact_load_speed", "m/s", CONTACT)]  # (m,) see `ConstraintSystem`
    dt: Annotated[float, Saved("contact_dt", "s")]  # the step for which these speeds were computed
    # (k, 2), sorted; usually the same as ``pairs``
    held_pairs: Annotated[IntArray, Saved("held_pairs", "", HELD, 2, is_pairs=True, repeats="pairs")]
    # (k, 4): λ_n, λ_t; (k, 7) where the law resists rolling, with Λ
    impulse: Annotated[FloatArray, Saved("held_impulse", "N s", HELD, 4), Saved("held_angular", "N m s", HELD, 3)]
    kick: Annotated[float, Saved("held_kick", "s")]  # length of that kick
    sleep: SleepCheckpoint | None = None  # None where no body can sleep
    # (3,) of the piston: displacement in m, velocity in m/s, impulse of the bodies on it in N s; None without one
    piston: Annotated[FloatArray | None, Saved("piston", "", RUN, 3)] = None

    @property
    def highest(self) -> int:
        """The highest index of a body or plane in a contact, or -1 without contacts."""
        slept = self.held_pairs[:0] if self.sleep is None else self.sleep.pairs
        return max((int(pairs.max()) for pairs in (self.pairs, self.held_pairs, slept) if len(pairs)), default=-1)
