"""[time]: the duration, and how the step is chosen."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Literal, Self

from pydantic import Field, model_validator

from carom.scene.integrators import AUTO, INTEGRATORS, described
from carom.scene.schema.quantity import Positive, Section
from carom.scene.units.dimension import LENGTH, TIME

if TYPE_CHECKING:
    IntegratorName = str
else:
    IntegratorName = Literal[(AUTO, *INTEGRATORS)]


LARGEST_ACCURACY = 1e-2
_STEP_KEYS = {
    "fixed_dt": None,
    "target_dx": "auto",
    "cfl": "auto",
    "pull_fraction": "auto",
    "smoothing": "auto",
    "velocity_limit": "every-body",
}  # keys of [time] that set the step, with the values that leave it free


class Time(Section):
    """[time]: the duration, and how the step is chosen."""

    duration: Annotated[Positive, TIME] = Field(10.0, description="s, simulated time; more than 0")
    max_dt: Annotated[Positive, TIME] | Literal["auto"] = Field(
        "auto",
        description='s, largest step; more than 0; "auto" is 1 s, and no limit where the integrator chooses its steps '
        "by their error or by the orbits",
    )
    target_dx: Annotated[Positive, LENGTH] | Literal["auto"] = Field(
        "auto",
        description="m, largest distance that an acceleration may move a body from rest in a step; "
        '"auto" is a fraction of the smallest radius, smaller for fewer bodies, and no limit where nothing can touch',
    )
    cfl: Positive | Literal["auto"] = Field(
        "auto",
        description="largest distance that a body may move in a step, as a fraction of its own radius; more than 0; "
        '"auto" is 0.5, 1 where impacts are resolved at their own times and nothing presses contacts together, and '
        "no limit where nothing can touch",
    )
    pull_fraction: Annotated[Positive, Field(le=1)] | Literal["auto"] = Field(
        "auto",
        description="step as a fraction of the shortest time in which a pull changes the motion of a pair, "
        'r/√(v² + G(m_i + m_j)/r); more than 0, at most 1; "auto" is 0.01 where bodies pull each other and cannot '
        "touch (with more than 100 bodies 0.02, from the largest acceleration), and no limit elsewhere or with a "
        "target_dx",
    )
    smoothing: Annotated[Positive, Field(le=1)] | Literal["auto"] = Field(
        "auto",
        description="weight of the new step in the moving average; more than 0; 1 is no smoothing; "
        '"auto" is 0.2, and 1 where only pull_fraction limits the step',
    )
    velocity_limit: Literal["every-body", "fastest-body"] = Field(
        "every-body", description="bodies whose radius and speed limit the step: all, or only the fastest"
    )
    fixed_dt: Annotated[Positive, TIME] | None = Field(
        None, description="s, constant step in place of the adaptive one"
    )
    accuracy: Annotated[Positive, Field(le=LARGEST_ACCURACY)] | None = Field(
        None,
        description="relative error to keep, in place of a step: of positions over the size of the system, and of "
        "times of impact over the duration; more than 0, at most 0.01; impacts then happen at their own times",
    )
    integrator: IntegratorName = Field(
        AUTO,
        description=f"{described()}; auto is Gauss–Radau where up to 100 bodies pull each other and cannot touch, "
        "or up to 32 begin far apart, Wisdom–Holman where bodies that cannot touch go around a dominant one 1000 times "
        "or more on orbits apart, Yoshida's where they cannot touch and the scene sets its step, otherwise leapfrog",
    )
    encounters: Literal["resolve", "ignore"] = Field(
        "resolve",
        description="wisdom-holman only: whether close encounters of light bodies are left to Gauss–Radau, which then "
        "integrates all bodies, or pass unresolved, for many bodies of negligible masses",
    )

    @model_validator(mode="after")
    def _an_accuracy_sets_the_step(self) -> Self:
        if self.accuracy is None:
            return self
        steps = [key for key, default in _STEP_KEYS.items() if getattr(self, key) != default]
        if steps:
            given = " and ".join(f"{key} = {getattr(self, key)}" for key in steps)
            overrides = " and ".join(f"time.{key}=" for key in steps)
            way = f"override {overrides} removes it" if len(steps) == 1 else f"overrides {overrides} remove them"
            raise ValueError(
                f"{given} with accuracy = {self.accuracy:g}, which sets the step; remove the one or the other "
                f"(the {way})"
            )
        if self.integrator != AUTO and not INTEGRATORS[self.integrator].keeps_accuracy:
            others = ", ".join(f'"{each.name}"' for each in INTEGRATORS.values() if each.keeps_accuracy)
            raise ValueError(
                f'integrator = "{self.integrator}" with accuracy = {self.accuracy:g}, which needs its error; take '
                f'{others} or "{AUTO}"'
            )
        return self
