"""Frames: copies of the state after a step, for readers of the run."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from carom.arrays import FloatArray, Records
from carom.contact_table import CONTACT_ROW
from carom.event import Event
from carom.physics.aligned import Buffer
from carom.physics.bodies import Bodies
from carom.physics.checkpoint import Books, Checkpoint, fingerprint_of
from carom.physics.contact.contact_checkpoint import ContactCheckpoint
from carom.physics.contact.graph import CollisionGraph
from carom.physics.diagnostics.energy import Energy
from carom.physics.integrators.batch_integrator import IntegratorCheckpoint


class FrameStore:
    """A ring buffer for the arrays of many frames, in which the frames of a batch are contiguous.

    Reused memory is in the cache and causes no page faults. Allocating memory for a frame of 1000 bodies took 50 µs.
    When all ``slots`` are in use, the oldest frame is overwritten as soon as ``until_free`` returns.
    """

    def __init__(self, slots: int, bodies: Bodies, until_free: Callable[[], None] = lambda: None) -> None:
        self.slots = slots
        self._until_free = until_free
        self._buffers = tuple(np.zeros((slots, *array.shape)) for array in _arrays(bodies))
        self.position, self.velocity, self.acceleration, self.orientation, *of_spin = self._buffers
        self.angular_velocity, self.torque, self.angular_acceleration = of_spin
        self.contact_rows = defaultdict[int, Buffer](lambda: Buffer(CONTACT_ROW))  # by slot
        self._bodies = bodies
        self._views: list[tuple[FloatArray, ...] | None] = [None] * slots
        self._next = 0

    def keep(self) -> int:
        """Copy the arrays of the bodies into the next slot once it is free; return its number."""
        self._until_free()
        slot, self._next = self._next, (self._next + 1) % self.slots
        for array, buffer in zip(_arrays(self._bodies), self._buffers, strict=True):
            buffer[slot] = array
        return slot

    def kept(self, slot: int) -> tuple[FloatArray, ...]:
        """Return the arrays of a slot, in the order of the attributes."""
        views = self._views[slot]
        if views is None:
            views = self._views[slot] = tuple(buffer[slot] for buffer in self._buffers)
        return views


def _arrays(bodies: Bodies) -> tuple[FloatArray, ...]:
    return (
        bodies.position,
        bodies.velocity,
        bodies.acceleration,
        bodies.orientation,
        bodies.angular_velocity,
        bodies.torque,
        bodies.angular_acceleration,
    )


def copies(bodies: Bodies) -> tuple[FloatArray, ...]:
    """Copy the arrays of the bodies, in the order of a `FrameStore`."""
    return tuple(array.copy() for array in _arrays(bodies))


@dataclass(frozen=True, slots=True)
class Frame:
    """The state after one step; step 0 is the initial state.

    Arrays are copies, so a frame may wait in a queue. Arrays in a `FrameStore` are valid until their slot is reused.
    Parts that the scene does not require are None.
    """

    step: int
    time: float  # s
    dt: float  # s, the step that ended here; 0 at step 0
    dt_limit: str  # what set dt: "acceleration", "held", "velocity", "pull", "error", "impact", "cap", "fixed", "end" …
    position: FloatArray  # (n, 3) m
    velocity: FloatArray  # (n, 3) m/s
    acceleration: FloatArray  # (n, 3) m/s², of all forces but drag
    orientation: FloatArray | None  # (n, 4) xyzw
    angular_velocity: FloatArray | None  # (n, 3) rad/s
    torque: FloatArray | None  # (n, 3) N m, of contacts that last, in this step
    angular_acceleration: FloatArray | None  # (n, 3) rad/s², by these torques
    contacts: CollisionGraph  # of this step; empty where no contact is possible
    energy: Energy  # J
    momentum: FloatArray  # (3,) kg m/s
    angular_momentum: FloatArray  # (3,) kg m²/s about the origin
    sweeps: int  # passes over the colours in this step
    phase: str  # "warm-up", "free", "colliding" or "settled"
    events: tuple[Event, ...]  # since the previous frame, in order of time
    previous_dt: float  # s, the smoothed step, without the cut at the end of a run
    memory: ContactCheckpoint | None  # state of the lasting contacts; None if contacts cannot last
    books: Books
    # |p - expected| relative to the largest Σ m |v| so far; None where something is fixed
    momentum_error: float | None = None
    angular_momentum_error: float | None = None  # the same of L; also None in a periodic box, which does not conserve L
    integrator: IntegratorCheckpoint | None = None  # state that the integrator's next step needs; None if it needs none
    slot: int | None = None  # slot of its arrays in a `FrameStore`; None if the frame owns them
    # (k,) `CONTACT_ROW`, since the previous frame, in order of time; None if not requested
    impacts: Records | None = None
    impacts_left_out: int = 0  # number of further impacts; `impacts` then holds those with the largest impulses
    impact_sums: FloatArray | None = None  # `ImpactSums.flat`, of all impacts since the previous frame; None: not known
    contact_rows: Records | None = None  # (m,) `CONTACT_ROW`, by pair: the contacts of this step; None if not requested
    angular_impulse: FloatArray | None = None  # (n, 3) N m s, Σ r × J of the impacts of this step
    expected_error: float = 0.0  # of positions, relative to the size of the system; 0 without a requested accuracy

    @property
    def fingerprint(self) -> int:
        """A 64-bit fingerprint of the exact state, computed at each access by the calling thread."""
        return fingerprint_of(self.time, (self.position, self.velocity, self.orientation, self.angular_velocity))

    @property
    def checkpoint(self) -> Checkpoint:
        """The checkpoint from which a run can continue; it shares the arrays of the frame."""
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
