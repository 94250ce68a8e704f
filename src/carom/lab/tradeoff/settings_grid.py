"""The settings of a scene to be compared, their results as entries of ``tradeoff.json``, and the Pareto front.

A setting is on the front if no other setting beats it in both cost and error. Errors are the same in every run. Costs
are noisy, so each cost is an interval. A setting is beaten if another setting has no larger error and a cost interval
that lies entirely below this setting's. A setting is on the front if the cost intervals of all settings with no larger
error lie entirely above its own. Otherwise the setting is undecided. If two measurements give overlapping intervals for
each setting, no setting is on the front in one measurement and beaten in the other. A front of medians would change
with every measurement of settings with equal costs. Unequal errors that differ by less than the uncertainty of the
reference are not distinguished.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, field
from statistics import median

import numpy as np

from carom.arrays import BoolArray, FloatArray
from carom.errors import SceneError
from carom.lab.compared_run import AS_WRITTEN, STEPS, Setting
from carom.lab.tradeoff.reference import Errors, refined
from carom.plan import auto
from carom.plan.features import require
from carom.plan.hierarchy import why_no_hierarchy
from carom.plan.interactions import damping
from carom.scene import variation
from carom.scene.integrators import INTEGRATORS, integrator_called
from carom.scene.load import Scene

STEPS_WORD = "steps"  # first word in the name of a setting that multiplies every step
STEP = "step"  # a pseudo-key: a factor on all limits of the step that apply
THREADS = "threads"  # number of threads of the kernels, which changes the cost but no bits
TIMING = "contact.timing"
DIRECT_UP_TO = 20  # largest number of bodies for which no tree is tried
# largest number of bodies for settings with an accuracy; with more, looking ahead takes longer than all other settings
MOST_ACCURATE = 100
ACCURACIES = ("1e-4", "1e-8")
METHOD = (  # keys and sections that change how a scene is computed
    "time",
    *(f"gravity.{key}" for key in ("method", "opening_angle", "quadrupoles")),
    *(f"contact.{key}" for key in ("solver", "sweeps", "stabilisation", "colouring", "search", "timing", "sleep")),
    "model",
)
# times √n, the number of ranks from the median to either end of its 95 % interval: 1.96 binomial deviations
MEDIAN_INTERVAL = 0.98
STEP_KEYS = ("fixed_dt", "target_dx", "cfl", "pull_fraction", "smoothing", "velocity_limit", "integrator")


@dataclass(frozen=True, slots=True)
class GridPoint:
    """A setting given by its coordinates: a factor on the step, and the keys with changed values."""

    step: float = 1.0
    values: tuple[tuple[str, str], ...] = ()  # keys and values, as given to ``--set``

    def value(self, key: str) -> str | None:
        """Return the value of a key; None if it is unchanged."""
        return dict(self.values).get(key)

    def having(self, key: str, value: str | None) -> GridPoint:
        """Return the point with another value of a key; None restores the value of the scene."""
        others = {k: v for k, v in self.values if k != key}
        return GridPoint(self.step, tuple(sorted((others if value is None else {**others, key: value}).items())))

    def times(self, factor: float) -> GridPoint:
        """Return the point with another factor on the step."""
        return GridPoint(self.step * factor, self.values)

    def setting(self, scene: Scene) -> Setting:
        """Return the point as a setting of a scene."""
        return _setting(scene, (*(_value(key, value) for key, value in self.values), _times(self.step)))


def knobs(scene: Scene) -> dict[str, tuple[str, ...]]:
    """Return the keys that trade speed for accuracy in a scene, each with values to try."""
    parts = require(scene)
    forces, located = parts.accelerates, parts.impact_time.modelled
    found: dict[str, tuple[str, ...]] = {}
    if not parts.contact.modelled:
        found["time.integrator"] = _integrators(scene)
    elif forces:
        found["time.integrator"] = tuple(name for name in _integrators(scene) if INTEGRATORS[name].holds_contacts)
        found["contact.solver"] = ("lasting", "staged")
    if parts.contact.modelled:
        if forces or not located:  # otherwise the solver at the end of a step has almost no work
            found["contact.sweeps"] = ("quick", "2")
            found["contact.stabilisation"] = ("split", "none", "baumgarte")
        found["contact.timing"] = ("end-of-step", "time-of-impact")
        if parts.adaptive_step.modelled:
            found["time.velocity_limit"] = ("every-body", "fastest-body")
            found["time.smoothing"] = ("1",)
    if parts.contact.modelled and parts.gravity.modelled and scene.count > DIRECT_UP_TO:
        if auto.uses_tree(scene):
            found["gravity.opening_angle"] = ("0.3", "0.5", "0.8")
            if auto.gravity_method(scene) == "tree":
                found["gravity.quadrupoles"] = ("true", "false")
        else:
            found["gravity.method"] = ("tree",)
    if scene.has_piston:  # scenes with pistons refuse other values of these keys
        for key in ("time.integrator", "contact.solver"):
            found.pop(key, None)
    # the values of the scene, with automatic ones resolved
    contact, gravity = scene.contact, scene.gravity
    own = {
        "time.integrator": auto.integrator(scene).name,
        "time.velocity_limit": scene.time.velocity_limit,
        "time.smoothing": f"{auto.smoothing(scene):g}",
        "contact.solver": contact.solver,
        "contact.sweeps": str(contact.sweeps),
        "contact.stabilisation": contact.stabilisation,
        "contact.timing": auto.timing(scene),
        "gravity.method": auto.gravity_method(scene),
        "gravity.opening_angle": f"{gravity.opening_angle:g}",
        "gravity.quadrupoles": str(gravity.quadrupoles).lower(),
    }
    return {key: tuple(value for value in values if value != own[key]) for key, values in found.items()}


def _integrators(scene: Scene) -> tuple[str, ...]:
    damped, orbits = damping(scene) is not None, not why_no_hierarchy(scene)
    return tuple(
        name for name, each in INTEGRATORS.items() if (each.damps or not damped) and (orbits or not each.hierarchical)
    )


def default_points(scene: Scene) -> list[GridPoint]:
    """Return about a dozen useful settings for the parts that the scene requires; the first is the scene itself.

    Raises SceneError if the scene has an accuracy, which chooses the step: default settings vary the step and the keys
    that set it.
    """
    if scene.time.accuracy is not None:
        raise SceneError(
            f"time.accuracy = {scene.time.accuracy:g} chooses the step, so settings cannot be compared; remove it "
            "with --set time.accuracy= or name the settings, as in --vary time.accuracy=1e-4,1e-6",
            ("time", "accuracy"),
        )
    parts, other = require(scene), knobs(scene)
    forces, located = parts.accelerates, parts.impact_time.modelled
    if not parts.contact.modelled:
        own = GridPoint()
        orders = [own, *(own.having("time.integrator", value) for value in other.get("time.integrator", ()))]
        euler = [point for point in orders if point.value("time.integrator") == "euler"]
        stepped = [point for point in orders if point not in euler and not _controls_error(scene, point)]
        exact = [point for point in orders if point != own and _controls_error(scene, point)]
        return [own, *euler, *(p.times(k) for p in stepped for k in STEPS if p.times(k) != own), *exact]
    steps = [1.0, 4.0, 2.0, 0.5] if forces else [1.0, 4.0, 2.0, 0.5, 8.0, 0.25]
    if _controls_error(scene, GridPoint()):
        steps = [step for step in steps if step <= 1.0]
    points = [GridPoint(step) for step in steps]
    points += [GridPoint().having(key, value) for key, values in other.items() if key != TIMING for value in values]
    otherwise = [2.0] if forces else [1.0, 0.25] if located else [8.0, 1.0]
    return points + [GridPoint(step).having(TIMING, value) for value in other.get(TIMING, ()) for step in otherwise]


def _controls_error(scene: Scene, point: GridPoint) -> bool:
    """Return whether a factor on the step has no effect at a point, because the integrator controls its error."""
    return integrator_called(point.value("time.integrator") or auto.integrator(scene).name).controls_error


def default_settings(scene: Scene) -> list[Setting]:
    """Return the default points as settings; for few bodies that cannot touch, also accuracies in place of a step."""
    settings = [point.setting(scene) for point in default_points(scene)]
    if not require(scene).contact.modelled and scene.count <= MOST_ACCURATE:
        removed = [f"time.{key}=" for key in STEP_KEYS if key in scene.time.model_fields_set]
        settings += [Setting(f"accuracy = {each}", (*removed, f"time.accuracy={each}")) for each in ACCURACIES]
    return settings


def vary(scene: Scene, choices: list[str]) -> list[Setting]:
    """Return the settings of a grid; raises SceneError if a key or a value is wrong.

    Each choice is ``key=a,b,c`` or ``key=first:last:count``, as in `carom sweep`; all combinations of the values are
    settings. The key ``step`` multiplies the limits of the step. ``threads`` is not part of the scene and changes only
    the cost.
    """
    settings = [_setting(scene, picked) for picked in itertools.product(*map(_axis, choices))]
    for choice in choices:
        # keys that change the scene itself are refused, since errors are relative to it
        key = choice.partition("=")[0].strip()
        known = (STEP, THREADS, *METHOD)
        if key == "time.duration" or not any(f"{key}.".startswith(f"{one}.") for one in known):
            raise SceneError(
                f"--vary {key}: it changes the scene instead of its computation; vary {', '.join(known)}; "
                "`carom sweep` varies all keys"
            )
    return settings


@dataclass(frozen=True, slots=True)
class _Choice:
    """One value of one key."""

    word: str = ""  # word in names of settings
    override: str = ""  # override as given to ``--set``
    step: float = 1.0  # factor on the step
    threads: int | None = None


def _setting(scene: Scene, picked: tuple[_Choice, ...]) -> Setting:
    """Combine choices; the factor applies to the step under all other choices."""
    overrides = [choice.override for choice in picked if choice.override]
    words = [choice.word for choice in picked if choice.word]
    step = math.prod(choice.step for choice in picked)
    if step != 1.0:
        chosen = Setting("", tuple(overrides)).apply(scene)
        finer = refined(chosen, 1.0 / step)
        overrides += finer
        words += [_longer(step)] if scales_steps(chosen) else [_factor(override, step) for override in finer]
    name = ", ".join(words) or AS_WRITTEN.name
    threads = next((choice.threads for choice in picked if choice.threads), None)
    setting = Setting(name, tuple(overrides), threads)
    setting.apply(scene)
    return setting


def _axis(choice: str) -> list[_Choice]:
    """Read the values of a key."""
    key, separator, values = choice.partition("=")
    key = key.strip()
    if not separator or not key:
        raise SceneError(f"--vary {choice}: expected key=a,b,c, such as time.integrator=euler,leapfrog")
    try:
        parts = variation.texts_of(values)
    except ValueError as error:
        raise SceneError(f"--vary {key}: {error}") from None
    if key == STEP:
        try:
            factors = [float(value) for value in parts]
        except ValueError:
            factors = [0.0]
        if not all(0.0 < factor < math.inf for factor in factors):
            raise SceneError(f"--vary {choice}: expected numbers above 0, which multiply the step")
        return [_times(factor) for factor in factors]
    if key == THREADS:
        if not all(value.isdigit() and int(value) > 0 for value in parts):
            raise SceneError(f"--vary {choice}: expected numbers of threads: 1, 2 and so on")
        return [_Choice(f"threads = {value}", threads=int(value)) for value in parts]
    return [_value(key, value) for value in parts]


def _value(key: str, value: str) -> _Choice:
    return _Choice(f"{key.rpartition('.')[2]} = {value}", f"{key}={value}")


def _times(step: float) -> _Choice:
    return _Choice(step=step)


def _longer(step: float) -> str:
    """Name a factor on every step."""
    return f"{STEPS_WORD} {step:g} times as long" if step > 1.0 else f"{STEPS_WORD} {1.0 / step:g} times as short"


def scales_steps(scene: Scene) -> bool:
    """Return whether a factor on the limits of the step scales every step.

    The factor does not scale every step if the integrator chooses its steps by its own error, or if bodies held by
    contacts have an automatic limit of their own, since no key sets that limit.
    """
    if scene.time.fixed_dt is not None:
        return True
    return not auto.integrator(scene).controls_error and auto.held_dx(scene) is None


def _factor(override: str, step: float) -> str:
    """Name the factor of one limit; ``target_dx`` is a distance of ½ a dt²."""
    key = override.partition("=")[0].removeprefix("time.")
    return f"{key} × {step * step if key == 'target_dx' else step:g}"


@dataclass
class SettingResult:
    """A setting and its measurements so far."""

    setting: Setting
    status: str = "pending"  # "measured", "refused", "stopped", "failed" or "left out"
    reason: str = ""  # why the setting was refused, stopped, left out or not timed, or why it failed
    costs: list[float] = field(default_factory=list)  # s, cost of each timed run
    steps: int = 0
    frames: int = 0  # frames in a recording of the run
    errors: Errors | None = None
    spent: float = 0.0  # s, CPU time that the run had used when it was stopped
    followed: float = 0.0  # s, time of the run that measured the errors; 0 if unknown
    digest: str = ""  # digest of the setting's trajectory
    same_as: str = ""  # name of an earlier setting whose run has the same bits, and therefore the same costs

    @property
    def cost(self) -> float:
        """Median cost in s; NaN if there is none."""
        return median(self.costs) if self.costs else math.nan

    @property
    def spread(self) -> float:
        """Half the 95 % interval of the median cost, relative to the median; 0 for a single cost.

        The ends of the interval are two of the sorted costs, equally far from the first and the last cost. With up to
        eight costs, it is their whole range; with fewer than six, its certainty is below 95 %.
        """
        if not self.costs:
            return 0.0
        n, ordered = len(self.costs), sorted(self.costs)
        outside = max(0, math.floor((n - 1) / 2 - MEDIAN_INTERVAL * math.sqrt(n)))
        return (ordered[n - 1 - outside] - ordered[outside]) / 2 / self.cost

    def share_costs_of(self, other: SettingResult) -> None:
        """Share the costs of another setting whose run is identical."""
        self.same_as, self.costs = other.setting.name, other.costs

    @property
    def complete(self) -> bool:
        """Whether the setting has both an error and a cost."""
        return bool(self.costs) and self.errors is not None


def pareto_front(
    cost: FloatArray, error: FloatArray, noise: FloatArray, doubt: float = 0.0
) -> tuple[BoolArray, BoolArray]:
    """Mark the points on the front, and the undecided ones.

    Parameters
    ----------
    cost, error
        (m,) each; a point with a NaN in either is never marked and beats nothing.
    noise
        (m,) relative noise: the true cost lies between cost / (1 + noise) and cost (1 + noise).
    doubt
        Uncertainty of the errors; unequal errors that differ by less are not distinguished.

    Returns
    -------
    on, near
        (m,) each; no point is both.
    """
    known = ~np.isnan(cost + error)
    low, high = cost / (1.0 + noise), cost * (1.0 + noise)
    one, other = error[:, None], error[None, :]  # element [j, k] compares setting j with setting k
    better = one + doubt < other
    no_worse = better | (one + doubt == other) | (one == other)
    rivals = known[:, None] & ~np.eye(len(cost), dtype=bool)
    below = (high[:, None] < low[None, :]) | (better & (high[:, None] <= low[None, :]))
    beaten = np.any(rivals & no_worse & below, axis=0)
    in_doubt = np.any(rivals & (one <= other + doubt) & (low[:, None] < high[None, :]), axis=0)
    return known & ~beaten & ~in_doubt, known & ~beaten & in_doubt
