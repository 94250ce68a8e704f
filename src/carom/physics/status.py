"""The status of a run for other threads: published after each step, and immutable."""

from __future__ import annotations

from typing import NamedTuple

from carom.physics.diagnostics.energy import Energy


class StepStatus(NamedTuple):
    """Progress of a run at the end of a step."""

    step: int
    time: float  # s
    dt: float  # s
    dt_limit: str  # the limit that set dt
    contacts: int  # number of contacts that touch or carry an impulse
    energy: Energy  # as of the last check or frame

    @property
    def energy_error(self) -> float:
        """|integration error| over the energy scale."""
        return self.energy.relative_error
