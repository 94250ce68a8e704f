"""[promise]: what a run needs to keep time.accuracy."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from carom.scene.schema.quantity import NonNegative, Positive, Real, Section
from carom.scene.units.dimension import RATE, TIME


class Promise(Section):
    """[promise]: what a run needs to keep time.accuracy; carom finds it and writes it into the recorded scene."""

    refinement: Positive = Field(
        description="longest useful steps over those of the run, or the usual ones of gauss-radau15 and wisdom-holman; "
        "more than 0"
    )
    until: Annotated[Positive, TIME] = Field(description="s, the part of the run that was looked ahead; more than 0")
    looked: Annotated[NonNegative, TIME] | None = Field(
        None,
        description="s, time that the runs ahead reached, where their budget ended before `until`; none: all of it; "
        "not negative",
    )
    horizon: Annotated[NonNegative, TIME] | None = Field(
        None, description="s, time up to which the accuracy is kept; none: as far as was looked; not negative"
    )
    integrator: Literal["wisdom-holman"] | None = Field(
        None, description="the integrator, where the run ahead chose another one than the scene"
    )
    lyapunov: Annotated[Real, RATE] = Field(
        description="1/s, largest Lyapunov exponent, over the time that was looked ahead"
    )
    error: Annotated[tuple[NonNegative, ...], Field(min_length=1)] = Field(
        description="expected error of positions over the size of the system, at equally spaced times up to `looked`, "
        "or `until`"
    )

    @property
    def kept_until(self) -> float:
        """The time in s up to which the accuracy is kept."""
        return self.until if self.horizon is None else self.horizon

    def error_at(self, time: float) -> float:
        """Return the expected error at a time in s, over the size of the system; 1 where it is unknown."""
        known = self.until if self.looked is None else self.looked
        if self.looked is not None and time > known:
            return 1.0
        place = min(time / known, 1.0) * len(self.error)
        k = min(int(place), len(self.error) - 1)
        before = self.error[k - 1] if k > 0 else 0.0
        return before + (place - k) * (self.error[k] - before)
