"""Restitution by a table: linear between measured speeds, constant below the first and above the last speed.

    e(v) = e₀ + Σ_k s_k max(0, v - v_k)

where s_k is the change of slope at speed v_k.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Annotated, Any, Self

from pydantic import Field, model_validator

from carom.extend import VELOCITY, ContactLaw, NonNegative, Section

MOST = 6  # largest number of points of a table; the record in kernels has a field for each


class RestitutionTable(Section):
    """[contact.restitution_table]: restitution measured at several speeds, linear between them."""

    speeds: tuple[Annotated[NonNegative, VELOCITY], ...] = Field(
        min_length=2, max_length=MOST, description="m/s, closing speeds, from slow to fast; 2 to 6 of them"
    )
    restitutions: tuple[Annotated[float, Field(strict=True, ge=0, le=1)], ...] = Field(
        min_length=2,
        max_length=MOST,
        description="speed of rebound over speed of approach at each of `speeds`, from 0 to 1",
    )

    @model_validator(mode="after")
    def _is_a_function(self) -> Self:
        if len(self.speeds) != len(self.restitutions):
            raise ValueError(
                f"{len(self.speeds)} speeds, {len(self.restitutions)} restitutions; give one restitution for each speed"
            )
        if any(after <= before for before, after in pairwise(self.speeds)):
            raise ValueError("speeds must increase, each one faster than the one before")
        return self


def numbers(section: RestitutionTable) -> dict[str, float]:
    """Return e₀, the speeds v_k and the changes of slope s_k, which are 0 for unused points of the record."""
    points = list(zip(section.speeds, section.restitutions, strict=True))
    slopes = [0.0, *((e2 - e1) / (v2 - v1) for (v1, e1), (v2, e2) in pairwise(points)), 0.0]
    bends = [after - before for before, after in pairwise(slopes)]
    lacking = MOST - len(points)
    speeds = [*section.speeds, *[section.speeds[-1]] * lacking]
    return (
        {"slowest_restitution": section.restitutions[0]}
        | {f"speed_{k}": speed for k, speed in enumerate(speeds)}
        | {f"bend_{k}": bend for k, bend in enumerate([*bends, *[0.0] * lacking])}
    )


def restitution(p: Any, approach: float, rest_speed: float) -> float:
    """Return e(v); 0 for contacts that close no faster than the rest speed."""
    if not approach > rest_speed:
        return 0.0
    e: float = (
        p.slowest_restitution
        + p.bend_0 * max(0.0, approach - p.speed_0)
        + p.bend_1 * max(0.0, approach - p.speed_1)
        + p.bend_2 * max(0.0, approach - p.speed_2)
        + p.bend_3 * max(0.0, approach - p.speed_3)
        + p.bend_4 * max(0.0, approach - p.speed_4)
        + p.bend_5 * max(0.0, approach - p.speed_5)
    )
    return max(0.0, min(1.0, e))  # rounding may leave this range


def dissipates(p: Any) -> bool:
    """Return True: a table without a value below 1 is rare, and the wrong answer costs only a little time."""
    return True


LAW = ContactLaw(RestitutionTable, restitution=restitution, dissipates=dissipates, coefficients=numbers)
