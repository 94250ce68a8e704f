"""What other threads may know of a run: published after each step, and never changed."""

from __future__ import annotations

from typing import NamedTuple

from carom.physics.diagnostics.energy import Energy


class StepStatus(NamedTuple):
    """Where a run stood at the end of a step."""

    step: int
    time: float  # s
    dt: float  # s
    dt_limit: str  # what kept the step from being longer
    contacts: int  # that touch or carry an impulse
    energy: Energy  # as of the last check or frame

    @property
    def energy_error(self) -> float:
        """|integration error| over the energy scale."""
        return self.energy.relative_error
