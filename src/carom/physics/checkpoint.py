"""The complete state of a run at one moment, from which it continues with the same bits, and its fingerprint.

The 64-bit fingerprint of a state is XXH64 of the bytes of its arrays, in their order.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Annotated

import numpy as np
import xxhash

from carom.arrays import FloatArray
from carom.physics.bodies import Bodies
from carom.physics.contact.contact_checkpoint import ContactCheckpoint
from carom.physics.diagnostics.dissipation import WrongWork
from carom.physics.diagnostics.energy import Energy, EnergyBaseline
from carom.physics.diagnostics.energy_monitor import MonitorState
from carom.physics.diagnostics.extremes import Extremes
from carom.physics.diagnostics.momentum import MomentumBaseline
from carom.physics.diagnostics.run_monitor import PaceTally
from carom.physics.integrators.batch_integrator import IntegratorCheckpoint
from carom.physics.saved import BODY, Saved


@dataclass(frozen=True, slots=True)
class Books:
    """Running totals and extremes of a run. The summary and the warnings depend on them; no step does."""

    energy: EnergyBaseline
    momentum: MomentumBaseline
    watch: MonitorState
    moments: Extremes
    activity: float  # J, activity of the impacts in the last steps
    phase: str
    limits: tuple[str, ...]  # limits of the method that were reached and reported so far
    pace: PaceTally
    wrong_work: tuple[WrongWork, ...] = ()  # of `diagnostics.dissipation`; empty if nothing was wrong


@dataclass(frozen=True, slots=True)
class Checkpoint:
    """The complete state after a step, in float64."""

    step: int
    time: Annotated[float, Saved("time", "s")]
    # the smoothed step, without the cut at the end of a run
    previous_dt: Annotated[float, Saved("previous_dt", "s")]
    position: Annotated[FloatArray, Saved("position", "m", BODY, 3, is_squared=True)]  # (n, 3)
    velocity: Annotated[FloatArray, Saved("velocity", "m/s", BODY, 3, is_squared=True)]  # (n, 3)
    acceleration: Annotated[FloatArray, Saved("acceleration", "m/s²", BODY, 3, is_squared=True)]  # (n, 3)
    # (n, 4) xyzw, and (n, 3); None where the scene requires none
    orientation: Annotated[FloatArray | None, Saved("orientation", "", BODY, 4, is_squared=True)]
    angular_velocity: Annotated[FloatArray | None, Saved("angular_velocity", "rad/s", BODY, 3, is_squared=True)]
    energy: Energy  # J
    contacts: ContactCheckpoint | None  # None where no contact lasts
    books: Books
    integrator: IntegratorCheckpoint | None = None  # None where the integrator carries nothing from step to step

    def write_to(self, bodies: Bodies) -> None:
        """Restore the state of the bodies. Torques are not stored, so they are zero until the next step."""
        bodies.position[:] = self.position
        bodies.velocity[:] = self.velocity
        bodies.acceleration[:] = self.acceleration
        bodies.torque[:] = 0.0
        bodies.angular_acceleration[:] = 0.0
        if self.orientation is not None:
            bodies.orientation[:] = self.orientation
        if self.angular_velocity is not None:
            bodies.angular_velocity[:] = self.angular_velocity

    @property
    def fingerprint(self) -> int:
        """The fingerprint of the state, which equals that of the frame."""
        return fingerprint_of(self.time, (self.position, self.velocity, self.orientation, self.angular_velocity))


def fingerprint(bodies: Bodies, time: float) -> int:
    """Return the fingerprint of time, positions, velocities, orientations and angular velocities, in this order."""
    return fingerprint_of(time, (bodies.position, bodies.velocity, bodies.orientation, bodies.angular_velocity))


def fingerprint_of(time: float, arrays: Iterable[FloatArray | None]) -> int:
    """Return the fingerprint of a time (s) and of arrays; None counts as no array."""
    digest = xxhash.xxh64(np.float64(time).tobytes())
    for array in arrays:
        if array is not None:
            digest.update(np.ascontiguousarray(array).data)
    return digest.intdigest()
