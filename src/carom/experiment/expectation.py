"""The promises of a scene's [expect], held against what a run measured."""

from __future__ import annotations

from dataclasses import dataclass

from carom.physics.moments import Moments
from carom.scene.schema import Expect


@dataclass(frozen=True, slots=True)
class Verdict:
    """One promise: what was allowed, what was measured."""

    name: str
    limit: float
    measured: float

    @property
    def met(self) -> bool:
        """Whether the promise was kept; what is not a number keeps none."""
        return self.measured <= self.limit

    def __str__(self) -> str:
        return f"{self.name}: {self.measured:.3g} (at most {self.limit:.3g}{'' if self.met else '; missed'})"


def judge(expect: Expect, moments: Moments) -> list[Verdict]:
    """Compare every promise that a scene makes with the extremes of its run.

    A quantity that the scene does not conserve, such as angular momentum in a periodic box, counts as infinitely wrong.
    """
    measured = {
        "energy_error": moments.energy_error.value if moments.energy_error else 0.0,
        "momentum_error": moments.momentum_error,
        "angular_momentum_error": float("inf")
        if moments.angular_momentum_error is None
        else moments.angular_momentum_error,
        "max_overlap": moments.overlap.value if moments.overlap else 0.0,
    }
    promised = {name: getattr(expect, name) for name in measured}
    return [Verdict(name, limit, measured[name]) for name, limit in promised.items() if limit is not None]
