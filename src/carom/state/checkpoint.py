"""The complete state of a run at one moment, from which it continues with the same bits, and its fingerprint.

The 64-bit fingerprint of a state is the XXH64 hash of its arrays' bytes, in their order.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Annotated, NamedTuple

import numpy as np
import xxhash

from carom.arrays import BoolArray, FloatArray, IntArray
from carom.state.books import Books
from carom.state.energies import Energy
from carom.state.saved import BODY, CONTACT, ENCOUNTER, HELD, INLET, OUTLET, PISTON, RUN, SLEEPING, Saved


@dataclass(frozen=True, slots=True)
class SleepCheckpoint:
    """The sleeping bodies, and their contacts. The arrays are never written to."""

    # (n,) s, time for which each body has been slow; -1 if it sleeps
    calm: Annotated[FloatArray, Saved("sleep_calm", "s", BODY)]
    # (n, 3) m/s², accelerations of the sleepers when they fell asleep
    reference: Annotated[FloatArray, Saved("sleep_reference", "m/s²", BODY, 3, is_squared=True)]
    # (k, 2) sorted pairs of sleepers and fixed ends
    pairs: Annotated[IntArray, Saved("sleep_pairs", "", SLEEPING, 2, is_pairs=True)]
    force: Annotated[FloatArray, Saved("sleep_force", "N", SLEEPING, 4)]  # (k, 4) N, normal and tangential force


PRESENT, GONE = -1.0, -2.0  # replace the time since which a body waits: the body exists, or it never enters again


@dataclass(frozen=True, slots=True)
class ReleaseCheckpoint:
    """The bodies that wait to enter. The arrays are never written to."""

    # (n,) s, time since which each body waits; `PRESENT` or `GONE`
    since: Annotated[FloatArray, Saved("release_since", "s", BODY)]
    # (k, 2) for each inlet: time in s at which its slots begin, and the number of taken slots
    slots: Annotated[FloatArray, Saved("release_slots", "", INLET, 2)]
    # (l, 2) for each outlet: number and mass in kg of the bodies that left since the start
    totals: Annotated[FloatArray, Saved("release_totals", "", OUTLET, 2)]

    def check(self) -> None:
        """Raise ValueError if the numbers do not describe bodies that wait."""
        if np.any((self.since < 0.0) & (self.since != PRESENT) & (self.since != GONE)):
            raise ValueError("release_since is not a time")


@dataclass(frozen=True, slots=True)
class ContactCheckpoint:
    """The contacts of a step that the next step needs, and the impulses of the last kick.

    The arrays are never written to.
    """

    # (m, 2) sorted pairs, including near contacts
    pairs: Annotated[IntArray, Saved("contact_pairs", "", CONTACT, 2, is_pairs=True)]
    # (m,) closing speed up to which each contact is at rest
    rest_speed: Annotated[FloatArray, Saved("contact_rest_speed", "m/s", CONTACT)]
    load_speed: Annotated[FloatArray, Saved("contact_load_speed", "m/s", CONTACT)]  # (m,) see `ConstraintSystem`
    dt: Annotated[float, Saved("contact_dt", "s")]  # step for which both speeds were computed
    # (k, 2) sorted pairs; usually the same as ``pairs``
    held_pairs: Annotated[IntArray, Saved("held_pairs", "", HELD, 2, is_pairs=True, repeats="pairs")]
    # (k, 4) N s: λ_n, λ_t; (k, 7) with Λ if the law resists rolling
    impulse: Annotated[FloatArray, Saved("held_impulse", "N s", HELD, 4), Saved("held_angular", "N m s", HELD, 3)]
    kick: Annotated[float, Saved("held_kick", "s")]  # length of the last kick
    sleep: SleepCheckpoint | None = None  # None if no body can sleep
    # (k, 3) for each piston: displacement in m, velocity in m/s, impulse of the bodies on it in N s; None if there are
    # no pistons
    pistons: Annotated[FloatArray | None, Saved("pistons", "", PISTON, 3)] = None
    release: ReleaseCheckpoint | None = None  # None if no body enters or leaves

    def among(self, kept: BoolArray, held: BoolArray) -> ContactCheckpoint:
        """Return a checkpoint with only some contacts, (m,), and some impulses of the last kick, (k,)."""
        return replace(
            self,
            pairs=self.pairs[kept],
            rest_speed=self.rest_speed[kept],
            load_speed=self.load_speed[kept],
            held_pairs=self.held_pairs[held],
            impulse=self.impulse[held],
        )

    @property
    def highest(self) -> int:
        """The highest index of a body or plane in a contact, or -1 if there are no contacts."""
        slept = self.held_pairs[:0] if self.sleep is None else self.sleep.pairs
        return max((int(pairs.max()) for pairs in (self.pairs, self.held_pairs, slept) if len(pairs)), default=-1)


def waiting(memory: ContactCheckpoint | None) -> BoolArray | None:
    """Return a mask (n,) of the bodies that wait to enter, or have left; None if no body enters or leaves."""
    release = None if memory is None else memory.release
    return None if release is None else np.asarray(release.since != PRESENT)


class EqualSteps(NamedTuple):
    """A series of equal steps of Wisdom–Holman integration, stored as five numbers in a checkpoint."""

    phase: float  # one of the phases in `wisdom_holman`
    start: float  # s, time at which the series began
    steps: float  # number of steps since the series began
    dt: float  # s
    limit: float  # index of the limit that set dt


@dataclass(frozen=True, slots=True)
class OrbitCheckpoint:
    """State of Wisdom–Holman integration; arrays are in the order of the Jacobi coordinates."""

    series: Annotated[FloatArray, Saved("orbit_series", "", RUN, len(EqualSteps._fields))]  # of `EqualSteps`
    order: Annotated[FloatArray, Saved("orbit_order", "", BODY)]  # (n,) index of each body in the scene
    near: Annotated[FloatArray, Saved("orbit_near", "m", BODY)]  # (n,) m, distance below which another body is close
    # (n, 3) m, Jacobi coordinates after the last kick
    position: Annotated[FloatArray, Saved("orbit_position", "m", BODY, 3)]
    velocity: Annotated[FloatArray, Saved("orbit_velocity", "m/s", BODY, 3)]  # (n, 3)

    def check(self) -> None:
        """Raise ValueError if no integration can have such a state."""
        series = EqualSteps(*self.series.tolist())
        if not np.array_equal(np.sort(self.order), np.arange(len(self.order))):
            raise ValueError("orbit_order is not an order of the bodies")
        if series.phase not in (0.0, 1.0, 2.0) or series.steps < 0.0 or series.limit not in (0.0, 1.0, 2.0):
            raise ValueError("orbit_series is not a series of equal steps")


@dataclass(frozen=True, slots=True)
class IntegratorCheckpoint:
    """State of Gauss–Radau integration; the last two arrays have three rows for each body, for x, y and z.

    With Wisdom–Holman integration, arrays have rows only in close encounters.
    """

    # length of the last step; 0 if it does not predict the next step; `BY_LEAPFROG` after leapfrog has taken over
    last_dt: Annotated[float, Saved("integrator_last_dt", "s")]
    # (n, 3) m, accumulated rounding errors of the positions
    position_rest: Annotated[FloatArray, Saved("integrator_position_rest", "m", ENCOUNTER, 3)]
    velocity_rest: Annotated[FloatArray, Saved("integrator_velocity_rest", "m/s", ENCOUNTER, 3)]  # (n, 3)
    # (3 n, 8) coefficients of the polynomial in the last step
    accepted: Annotated[FloatArray, Saved("integrator_accepted", "m/s²", ENCOUNTER, 8, rows=3)]
    # (3 n, 8) error of the predicted coefficients
    correction: Annotated[FloatArray, Saved("integrator_correction", "m/s²", ENCOUNTER, 8, rows=3)]
    orbits: OrbitCheckpoint | None = None  # None with Gauss–Radau integration alone

    def check(self) -> None:
        """Raise ValueError if no integration can have such a state."""
        if self.orbits is None and not len(self.accepted):
            raise ValueError("integrator_accepted has no values")


@dataclass(frozen=True, slots=True)
class Checkpoint:
    """The complete state after a step, in float64."""

    step: int
    time: Annotated[float, Saved("time", "s")]
    # s, the smoothed step, before the cut at the end of a run
    previous_dt: Annotated[float, Saved("previous_dt", "s")]
    position: Annotated[FloatArray, Saved("position", "m", BODY, 3, is_squared=True)]  # (n, 3)
    velocity: Annotated[FloatArray, Saved("velocity", "m/s", BODY, 3, is_squared=True)]  # (n, 3)
    acceleration: Annotated[FloatArray, Saved("acceleration", "m/s²", BODY, 3, is_squared=True)]  # (n, 3)
    # (n, 4) xyzw and (n, 3) rad/s; None if the scene requires none
    orientation: Annotated[FloatArray | None, Saved("orientation", "", BODY, 4, is_squared=True)]
    angular_velocity: Annotated[FloatArray | None, Saved("angular_velocity", "rad/s", BODY, 3, is_squared=True)]
    energy: Energy  # J
    contacts: ContactCheckpoint | None  # None if no contact lasts
    books: Books
    integrator: IntegratorCheckpoint | None = None  # None if the integrator carries nothing from step to step

    @property
    def waits(self) -> BoolArray | None:
        """Mask (n,) of the bodies that wait to enter, or have left; None if no body enters or leaves."""
        return waiting(self.contacts)

    @property
    def fingerprint(self) -> int:
        """The fingerprint of the state, equal to the fingerprint of the frame."""
        return fingerprint_of(self.time, (self.position, self.velocity, self.orientation, self.angular_velocity))


def fingerprint_of(time: float, arrays: Iterable[FloatArray | None]) -> int:
    """Return the fingerprint of a time (s) and of arrays; None stands for no array."""
    digest = xxhash.xxh64(np.float64(time).tobytes())
    for array in arrays:
        if array is not None:
            digest.update(np.ascontiguousarray(array).data)
    return digest.intdigest()
