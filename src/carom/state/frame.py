"""Frames: copies of the state after a step, for readers of the run."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from carom.arrays import BoolArray, FloatArray, IntArray, Records
from carom.event import Event
from carom.state.books import Books
from carom.state.checkpoint import Checkpoint, ContactCheckpoint, IntegratorCheckpoint, fingerprint_of, waiting
from carom.state.energies import Energy


@dataclass(frozen=True, slots=True)
class CollisionGraph:
    """The contacts of one step. A body is a node, a contact an edge.

    ``pairs`` are sorted by (i, j) with i < j, so the graph does not depend on the method of search.
    """

    pairs: IntArray  # (m, 2) indices; j ≥ n is plane j - n
    normals: FloatArray  # (m, 3) unit vectors from i to j, before position correction
    overlaps: FloatArray  # (m,) m, r_i + r_j - distance, before position correction
    colours: IntArray  # (m,) stage in which the contact is resolved
    # (n,) colouring of the nodes by the rule of the reference engine (docs/validation.md); -1 without contacts
    body_colours: IntArray | None = None
    # (m,) s, time from the start of the step to the first impact of each contact; None means the end of the step
    into_step: FloatArray | None = None

    def __len__(self) -> int:
        return len(self.pairs)

    @property
    def first(self) -> int:
        """Index of the contact that was resolved first."""
        return 0 if self.into_step is None else int(np.argmin(self.into_step))


def empty_graph() -> CollisionGraph:
    """Return the graph of a step in which nothing touches."""
    return CollisionGraph(
        pairs=np.empty((0, 2), dtype=np.int64),
        normals=np.empty((0, 3)),
        overlaps=np.empty(0),
        colours=np.empty(0, dtype=np.int64),
    )


@dataclass(frozen=True, slots=True)
class Frame:
    """The state after one step; step 0 is the initial state.

    Arrays are copies, so a frame may wait in a queue. Arrays in a `FrameStore` are valid until their slot is used
    again. Parts that the scene does not require are None.
    """

    step: int
    time: float  # s
    dt: float  # s, length of the step that ended here; 0 at step 0
    # limit that set dt: "acceleration", "held", "velocity", "pull", "error", "impact", "cap", "fixed", "end" …
    dt_limit: str
    position: FloatArray  # (n, 3) m
    velocity: FloatArray  # (n, 3) m/s
    acceleration: FloatArray  # (n, 3) m/s², acceleration by all forces but drag
    orientation: FloatArray | None  # (n, 4) xyzw
    angular_velocity: FloatArray | None  # (n, 3) rad/s
    torque: FloatArray | None  # (n, 3) N m, torque of the lasting contacts in this step
    angular_acceleration: FloatArray | None  # (n, 3) rad/s², angular acceleration by these torques
    contacts: CollisionGraph  # contacts of this step; empty if no contact is possible
    energy: Energy  # J
    momentum: FloatArray  # (3,) kg m/s
    angular_momentum: FloatArray  # (3,) kg m²/s, angular momentum about the origin
    sweeps: int  # passes over the colours in this step
    phase: str  # "warm-up", "free", "colliding" or "settled"
    events: tuple[Event, ...]  # events since the previous frame, in order of time
    previous_dt: float  # s, the smoothed step, before the cut at the end of a run
    memory: ContactCheckpoint | None  # state of the lasting contacts; None if contacts cannot last
    books: Books
    # |p - expected|, relative to the largest Σ m |v| so far; None if anything is fixed
    momentum_error: float | None = None
    # |L - expected|, relative to its scale; also None in a periodic box, which does not conserve L
    angular_momentum_error: float | None = None
    integrator: IntegratorCheckpoint | None = None  # state that the integrator's next step needs; None if it needs none
    slot: int | None = None  # slot of the frame's arrays in a `FrameStore`; None if the frame owns them
    # (k,) `CONTACT_ROW` of the impacts since the previous frame, in order of time; None if not requested
    impacts: Records | None = None
    impacts_left_out: int = 0  # number of impacts, those with the smallest impulses, that ``impacts`` omits
    impact_sums: FloatArray | None = None  # `ImpactSums.flat` over all impacts since the last frame; None if unknown
    contact_rows: Records | None = None  # (m,) `CONTACT_ROW` of this step's contacts, by pair; None if not requested
    angular_impulse: FloatArray | None = None  # (n, 3) N m s, Σ r × J over the impacts of this step
    # expected error of positions, relative to the size of the system; 0 if no accuracy is requested
    expected_error: float = 0.0

    @property
    def waits(self) -> BoolArray | None:
        """Mask (n,) of the bodies that wait to enter, or have left; None if no body enters or leaves."""
        return waiting(self.memory)

    @property
    def seen(self) -> FloatArray:
        """Positions (n, 3) m of the bodies that exist now; NaN for bodies that wait."""
        waits = self.waits
        return self.position if waits is None else np.where(waits[:, None], np.nan, self.position)

    @property
    def fingerprint(self) -> int:
        """A 64-bit fingerprint of the exact state, computed at each access by the calling thread."""
        return fingerprint_of(self.time, (self.position, self.velocity, self.orientation, self.angular_velocity))

    @property
    def checkpoint(self) -> Checkpoint:
        """The checkpoint from which a run can continue; the checkpoint shares the arrays of the frame."""
        return Checkpoint(
            step=self.step,
            time=self.time,
            previous_dt=self.previous_dt,
            position=self.position,
            velocity=self.velocity,
            acceleration=self.acceleration,
            orientation=self.orientation,
            angular_velocity=self.angular_velocity,
            energy=self.energy,
            contacts=self.memory,
            books=self.books,
            integrator=self.integrator,
        )
