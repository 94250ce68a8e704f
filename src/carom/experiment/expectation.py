"""The promises of a scene's [expect], held against what a run measured."""

from __future__ import annotations

from dataclasses import dataclass

from carom.physics.moments import Moment, Moments
from carom.scene.schema import Expect


@dataclass(frozen=True, slots=True)
class Verdict:
    """One promise: what was allowed, what was measured, and when it was at its worst."""

    name: str
    limit: float
    measured: float
    worst: Moment | None = None  # None where no moment is to blame
    at_least: bool = False  # the limit is one from below

    @property
    def met(self) -> bool:
        """Whether the promise was kept; what is not a number keeps none."""
        return self.measured >= self.limit if self.at_least else self.measured <= self.limit

    @property
    def bound(self) -> str:
        """From which side the limit holds, in words."""
        return "at least" if self.at_least else "at most"

    def __str__(self) -> str:
        missed = "" if self.met else "; missed"
        return f"{self.name}: {self.measured:.3g} ({self.bound} {self.limit:.3g}{missed})"


def judge(expect: Expect, moments: Moments) -> list[Verdict]:
    """Compare every promise that a scene makes with the extremes of its run.

    A quantity that the scene does not conserve, such as angular momentum in a periodic box or any momentum where
    something is fixed, counts as infinitely wrong.
    """
    measured = {
        "energy_error": (_value(moments.energy_error), moments.energy_error),
        "energy_gain": (moments.energy_gain.value, moments.energy_gain),
        "momentum_error": (_or_infinite(moments.momentum_error), moments.momentum_error),
        "angular_momentum_error": (_or_infinite(moments.angular_momentum_error), moments.angular_momentum_error),
        "max_overlap": (_value(moments.overlap), moments.overlap),
        "final_kinetic": (moments.kinetic.value, moments.kinetic),
        "impacts": (moments.impacts, None),
    }
    return [
        Verdict(name, limit, value, worst, at_least=name == "impacts")
        for name, (value, worst) in measured.items()
        if (limit := getattr(expect, name)) is not None
    ]


def _or_infinite(error: Moment | None) -> float:
    return float("inf") if error is None else error.value


def _value(moment: Moment | None) -> float:
    return moment.value if moment else 0.0
