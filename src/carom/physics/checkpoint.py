"""Everything that the rest of a run depends on, at one moment: enough to go on from, bit for bit."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from carom.physics.contact.checkpoint import ContactCheckpoint
from carom.physics.diagnostics.energy import Energy, EnergyBaseline
from carom.physics.diagnostics.energy_monitor import MonitorState
from carom.physics.diagnostics.extremes import Extremes
from carom.physics.diagnostics.fingerprint import fingerprint_of
from carom.physics.diagnostics.momentum import MomentumBaseline
from carom.physics.diagnostics.pace import PaceTally
from carom.physics.integrators.checkpoint import IntegratorCheckpoint

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Books:
    """What a run has counted so far. No step depends on it; what the run says of itself does."""

    energy: EnergyBaseline
    momentum: MomentumBaseline
    watch: MonitorState
    moments: Extremes
    activity: float  # J, of the impacts in the last steps
    phase: str
    limits: tuple[str, ...]  # of the method, reached and told so far
    pace: PaceTally = field(default_factory=PaceTally)  # recordings of before there was a watch lack it


@dataclass(frozen=True, slots=True)
class Checkpoint:
    """The state after a step; arrays are float64, exactly as they were."""

    step: int
    time: float  # s
    previous_dt: float  # s, the smoothed step before the end of the run trimmed it
    position: FloatArray  # (n, 3) m
    velocity: FloatArray  # (n, 3) m/s
    acceleration: FloatArray  # (n, 3) m/s²
    orientation: FloatArray | None  # (n, 4) xyzw; None where the scene requires none
    angular_velocity: FloatArray | None  # (n, 3) rad/s; likewise
    energy: Energy  # J
    contacts: ContactCheckpoint | None  # None where no contact lasts
    books: Books
    integrator: IntegratorCheckpoint | None = None  # None where each step begins anew

    @property
    def fingerprint(self) -> int:
        """The fingerprint of the state, as the frame of the same step has it."""
        parts = (self.position, self.velocity, self.orientation, self.angular_velocity)
        return fingerprint_of(self.time, [np.ascontiguousarray(part) for part in parts if part is not None])
