"""What one step hands out: a copy of everything a reader of the run may want, owned by nobody else."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from carom.physics.contact.graph import CollisionGraph
from carom.physics.energy import Energy

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Event:
    """Something worth a line in the log: when it happened, how grave it is, and what it was."""

    step: int
    time: float  # s
    level: str  # "INFO" or "WARN"
    text: str


@dataclass(frozen=True, slots=True)
class Checkpoint:
    """All that the next step depends on besides the arrays of the frame that carries it."""

    acceleration: FloatArray  # (n, 3) m/s²
    previous_dt: float  # s, the smoothed step before the end of the run trimmed it


@dataclass(frozen=True, slots=True)
class Frame:
    """The state after one step (step 0: the scene as written).

    Arrays are copies: a frame may outlive the step in a queue. Parts that the scene does not require are None.
    """

    step: int
    time: float  # s
    dt: float  # s, the step that led here; 0 at step 0
    dt_limit: str  # what set dt: "acceleration", "velocity", "cap", "growth", "fixed", "end" or "start"
    position: FloatArray  # (n, 3) m
    velocity: FloatArray  # (n, 3) m/s
    orientation: FloatArray | None  # (n, 4) xyzw; None without spin, like the four below
    angular_velocity: FloatArray | None  # (n, 3) rad/s
    torque: FloatArray | None  # (n, 3) N m
    angular_acceleration: FloatArray | None  # (n, 3) rad/s²
    contacts: CollisionGraph  # of this step; empty where no contact is possible
    energy: Energy  # J
    momentum: FloatArray  # (3,) kg m/s
    angular_momentum: FloatArray  # (3,) kg m²/s about the origin
    sweeps: int  # passes over the colours in this step
    phase: str  # "warm-up", "free", "colliding" or "settled"
    events: tuple[Event, ...]  # since the frame before, in order of time
    fingerprint: int  # 64 bits of the exact state
    checkpoint: Checkpoint
    momentum_error: float | None = (
        None  # |p - expected| over the largest Σ m |v| so far; None if something fixed takes it
    )
    angular_momentum_error: float | None = None  # likewise; None in a periodic box, too, which does not conserve it
