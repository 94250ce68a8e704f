"""[expect], [promise] and [sweep]: keys that are checked, written or varied by the commands that run a scene."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Any, Literal, Self

from pydantic import BeforeValidator, Field, model_validator

from carom.scene.schema.quantity import Count, Name, NonNegative, Positive, Real, Section, Vector
from carom.scene.units.dimension import ANGULAR_VELOCITY, LENGTH, RATE, TIME, VELOCITY
from carom.scene.variation import MOST_RUNS, Values, alike, flattened, values_of

# promises that apply only to a run of the promised duration
ABOUT_THE_END = ("final_kinetic", "impacts", "most_impacts", "state")
# quantities that theory may state
STATES = {"position": LENGTH, "velocity": VELOCITY, "angular_velocity": ANGULAR_VELOCITY}


class ExpectedState(Section):
    """[[expect.state]]: the state of a body at the end, as a closed form gives it, and the error that is allowed."""

    body: Name = Field(description="name of a [[body]]")
    position: Annotated[Vector, LENGTH] | None = Field(None, description="m, [x, y, z] of the centre")
    position_error: Annotated[NonNegative, LENGTH] | None = Field(
        None, description="m, largest distance from `position`"
    )
    velocity: Annotated[Vector, VELOCITY] | None = Field(None, description="m/s, [x, y, z]")
    velocity_error: Annotated[NonNegative, VELOCITY] | None = Field(
        None, description="m/s, largest difference from `velocity`"
    )
    angular_velocity: Annotated[Vector, ANGULAR_VELOCITY] | None = Field(None, description="rad/s, [x, y, z]")
    angular_velocity_error: Annotated[NonNegative, ANGULAR_VELOCITY] | None = Field(
        None, description="rad/s, largest difference from `angular_velocity`"
    )

    @model_validator(mode="after")
    def _each_value_has_its_error(self) -> Self:
        for name in STATES:
            value, error = getattr(self, name), getattr(self, f"{name}_error")
            if (value is None) is not (error is None):
                given, missing = (name, f"{name}_error") if error is None else (f"{name}_error", name)
                raise ValueError(f"{given} without {missing}; give both, or neither")
        if not any(self.values):
            raise ValueError(f"nothing is expected of the body; give {', '.join(STATES)}, each with its error")
        return self

    @property
    def values(self) -> Iterator[tuple[str, tuple[float, float, float], float]]:
        """The expected values: the name of each, the value and the largest error, in SI units."""
        for name in STATES:
            value, error = getattr(self, name), getattr(self, f"{name}_error")
            if value is not None:
                yield name, value, error


class Expect(Section):
    """[expect]: promises that are checked at the end; a run that breaks one reports it and exits with 1."""

    energy_error: NonNegative | None = Field(
        None,
        description="largest |integration error|, or energy added by contacts if that is larger, over the energy scale",
    )
    energy_gain: NonNegative | None = Field(
        None,
        description="largest rise of the total energy above its previous minimum, over the energy scale, at the "
        "checks of the energy",
    )
    momentum_error: NonNegative | None = Field(None, description="largest change of the momentum over its scale")
    angular_momentum_error: NonNegative | None = Field(
        None, description="largest change of the angular momentum over its scale"
    )
    max_overlap: NonNegative | None = Field(None, description="deepest overlap over the smaller radius")
    final_kinetic: NonNegative | None = Field(
        None, description="kinetic energy at the end, including spin, over the energy scale"
    )
    impacts: Count | None = Field(None, description="smallest number of impacts; 1 or more")
    most_impacts: Count | None = Field(None, description="largest number of impacts; 1 or more")
    state: tuple[ExpectedState, ...] = Field((), description="states of single bodies at the end, from closed forms")
    contact_audit: NonNegative | None = Field(
        None, description="largest change of a speed or of the ledger in a step that impulses and forces do not explain"
    )
    dissipation_error: NonNegative | None = Field(
        None,
        description="energy that contacts have moved against the signs of dissipation, over the energy scale: friction "
        "that adds energy, static friction that does work, impacts that lose or gain more than the restitution "
        "prescribes",
    )
    duration: Annotated[Positive, TIME] | None = Field(
        None,
        description="s, the duration to which final_kinetic, impacts, most_impacts, state and warned apply; by default "
        "the duration of the run",
    )
    warned: tuple[Literal["energy-rise", "energy-ledger", "energy-lost", "dissipation", "limit"], ...] = Field(
        (), description='kinds of warnings that the run must give, such as "energy-lost"'
    )


class Promise(Section):
    """[promise]: data that a run needs to keep time.accuracy; carom finds and stores them in the recorded scene."""

    refinement: Positive = Field(
        description="ratio of the longest useful steps, or of the usual ones of gauss-radau15 and wisdom-holman, to "
        "the steps of the run; more than 0"
    )
    until: Annotated[Positive, TIME] = Field(
        description="s, time up to which trial runs examined the accuracy; more than 0"
    )
    looked: Annotated[NonNegative, TIME] | None = Field(
        None,
        description="s, time at which the trial runs ended if their budget was spent before `until`; otherwise absent; "
        "a promise beyond it is extrapolated; not negative",
    )
    horizon: Annotated[NonNegative, TIME] | None = Field(
        None,
        description="s, time up to which the accuracy is kept; none if it is kept up to `until`; not negative",
    )
    integrator: Literal["wisdom-holman", "leapfrog", "yoshida4"] | None = Field(
        None, description="the integrator, if the trial runs chose another one than the scene"
    )
    lyapunov: Annotated[Real, RATE] = Field(description="1/s, largest Lyapunov exponent, measured over the trial runs")
    error: Annotated[tuple[NonNegative, ...], Field(min_length=1)] = Field(
        description="expected error of positions over the size of the system, at equally spaced times up to "
        "`until`, or to the later one of `looked` and `horizon`"
    )

    @property
    def kept_until(self) -> float:
        """The time (s) up to which the accuracy is kept."""
        return self.until if self.horizon is None else self.horizon

    @property
    def is_extrapolated(self) -> bool:
        """Whether the accuracy is kept beyond the times of the trial runs, by extrapolation."""
        return self.looked is not None and self.kept_until > self.looked

    def error_at(self, time: float) -> float:
        """Return the expected error at a time (s), relative to the size of the system; 1 if it is unknown."""
        known = self.until if self.looked is None else max(self.looked, self.kept_until)
        if self.looked is not None and time > known:
            return 1.0
        place = min(time / known, 1.0) * len(self.error)
        k = min(int(place), len(self.error) - 1)
        before = self.error[k - 1] if k > 0 else 0.0
        return before + (place - k) * (self.error[k] - before)


def _values_by_key(given: Any) -> Any:
    """Read the varied values: lists unchanged, text in the syntax of `--vary`."""
    if not isinstance(given, dict):
        return given
    values: dict[str, Values] = {}
    count = 0
    for key, value in flattened(given).items():
        values[key] = (
            values_of(value) if isinstance(value, str) else alike(value if isinstance(value, list) else [value])
        )
        count += len(values[key])
        if count > MOST_RUNS:
            raise ValueError(f"more than {MOST_RUNS} values; give fewer")
    return values


class Sweep(Section):
    """[sweep]: keys and values that `carom sweep` varies; `carom run` ignores them."""

    vary: Annotated[dict[str, Values], BeforeValidator(_values_by_key)] = Field(
        {}, description='values by key: a list, or text such as "0.1:0.9:5" or "1e-3:1:4log"'
    )
    seeds: Count | None = Field(
        None, description="runs of each combination, with consecutive seeds from the scene's own; 1 or more"
    )
    zip: Annotated[bool, Field(strict=True)] = Field(
        False,
        description="true: combine the first values of all keys, then the second, …; false: combine each with each",
    )
