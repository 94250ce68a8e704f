"""The complete state of a run at one moment, from which it continues with the same bits."""

from __future__ import annotations

from dataclasses import dataclass, field

from carom.arrays import FloatArray
from carom.physics.bodies import Bodies
from carom.physics.contact.contact_checkpoint import ContactCheckpoint
from carom.physics.diagnostics.energy import Energy, EnergyBaseline
from carom.physics.diagnostics.energy_monitor import MonitorState
from carom.physics.diagnostics.extremes import Extremes
from carom.physics.diagnostics.fingerprint import fingerprint_of
from carom.physics.diagnostics.momentum import MomentumBaseline
from carom.physics.diagnostics.run_monitor import PaceTally
from carom.physics.integrators.batch_integrator import IntegratorCheckpoint


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
    pace: PaceTally = field(default_factory=PaceTally)  # older recordings lack it


@dataclass(frozen=True, slots=True)
class Checkpoint:
    """The complete state after a step, in float64."""

    step: int
    time: float  # s
    previous_dt: float  # s, the smoothed step, without the cut at the end of a run
    position: FloatArray  # (n, 3) m
    velocity: FloatArray  # (n, 3) m/s
    acceleration: FloatArray  # (n, 3) m/s²
    orientation: FloatArray | None  # (n, 4) xyzw; None where the scene requires none
    angular_velocity: FloatArray | None  # (n, 3) rad/s; None where the scene requires none
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
