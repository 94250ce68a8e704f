"""The reference for measuring the settings of a scene: an exact solution, or the scene with smaller steps.

The motion of one ball between planes has closed forms (`ball_on_planes.py`). Two further solutions, whose starts are
displaced by rounding errors, serve as checks.

A few bodies in open space are solved exactly (`event_driven_reference.py`). Again, two further solutions serve as
checks. Their starts are displaced by rounding errors, which shows how fast chaos separates the runs; one of them has a
tolerance ten times looser. Other scenes are run with smaller and smaller steps, halved from run to run. Without forces,
flights are exact and only times of impact can be wrong, so these runs locate times of impact within the step. The last
run is the reference, and the run before it is the check.

The reference is trusted up to the *horizon*, where a check first deviates by more than a thousandth of the size of the
system. Up to the horizon, the uncertainty of the reference is the largest error of a check. Beyond the horizon, only
statistics can be compared.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import astuple, dataclass, replace

import numpy as np

from carom.arrays import FloatArray
from carom.lab.compared_run import Trajectory, follow, sample_times
from carom.lab.tradeoff.ball_on_planes import solve_ball, why_no_ball
from carom.lab.tradeoff.event_driven_reference import EPS, TIGHTEST, EventDrivenSolution, solve, why_not
from carom.lab.tradeoff.settled_pile import SEEDS, Pile, Settled
from carom.physics.placement import place
from carom.physics.space import Space
from carom.physics.vector import minimum_images
from carom.plan import auto
from carom.plan.features import require
from carom.runs.stopwatch import Stopwatch
from carom.scene.load import Scene
from carom.scene.units.dimension import LENGTH, TIME
from carom.scene.wording import counted


# Errors of a run relative to a reference: errors of positions and times up to a horizon, errors of statistics beyond
# it.
@dataclass(frozen=True, slots=True)
class Errors:
    """The errors of a run; NaN if not measured. Smaller is better for each."""

    # rms position error of all bodies and samples up to the horizon, relative to the size of the system
    position: float
    velocity: float  # rms velocity error of all bodies and samples, relative to the speed of the system
    impact: float  # s, rms error in the time of the first contact of pairs that met before the horizon
    # number of these pairs that do not meet by the horizon in the run; `impact` counts them as meeting at the horizon
    missed: float
    energy: float  # largest |integration error| in the ledger, relative to the energy scale
    energy_gain: float  # largest rise of the total energy above its previous minimum, relative to the energy scale
    momentum: float  # largest error of the momentum, relative to its scale
    angular_momentum: float
    overlap: float  # deepest overlap, relative to the smaller radius
    sinking: float  # error of the mean overlap of contacts late in the run; NaN if nothing can rest
    impacts: float  # | number of impacts / number of the reference's impacts - 1 |
    size: float  # rms error of the rms radius in all samples, relative to the reference
    dispersion: float  # error of the rms speed about the centre
    # the errors above that are compared at samples: the largest value, and the value at the end of the scene
    position_max: float
    position_end: float
    velocity_max: float
    velocity_end: float
    size_max: float
    size_end: float
    dispersion_max: float
    dispersion_end: float
    # errors of a settled pile, if trajectories are not compared to the end; see `settled_pile.Settled`
    height: float = math.nan  # relative to the reference
    density: float = math.nan  # relative to the reference
    coordination: float = math.nan  # error of the number of contacts per body
    settled_energy: float = math.nan  # relative to the reference
    rest_time: float = math.nan  # s, error of the time at which the pile comes to rest


NAMES = tuple(Errors.__dataclass_fields__)
OVER_TIME = ("position", "velocity", "size", "dispersion")  # errors that are measured at each sample
MEASURES = {"rms": "", "max": "_max", "end": "_end"}  # measures of an error over time, and the suffixes of their names
OF_SAMPLES = tuple(error + ending for error in OVER_TIME for ending in MEASURES.values())
COMPARED = (*OF_SAMPLES, "impact", "missed", "impacts", *Settled._fields)  # errors that need a reference


def phrase(error: str) -> str:
    """Return the name of an error in words, such as "position (rms)" or "position (largest)"."""
    base, _, measure = error.rpartition("_")
    if base in OVER_TIME:
        return f"{base} ({'largest' if measure == 'max' else 'at the end'})"
    return f"{error} (rms)" if error in OVER_TIME else PHRASES.get(error, error)


PHRASES = {  # descriptions of errors whose names say too little
    "impact": "time of first contact",
    "missed": "first contacts missed",
    "impacts": "number of impacts",
    "energy_gain": "energy gained",
    "angular_momentum": "angular momentum",
    "height": "settled height",
    "coordination": "contacts per body",
    "settled_energy": "energy at rest",
    "rest_time": "time to rest",
}


@dataclass(frozen=True, slots=True)
class ErrorScale:
    """The length and speed by which errors in position and velocity are divided."""

    length: float  # m, the largest rms distance from the centre, or half the box
    speed: float  # m/s, the largest rms speed about the mean velocity
    box: FloatArray | None = None  # (3,) m, size of a periodic domain

    @classmethod
    def of(cls, trajectory: Trajectory, box: FloatArray | None) -> ErrorScale:
        """Return the scale of a reference."""
        length = float(spread(trajectory.position).max()) if box is None else float(box.min()) / 2
        speed = float(spread(trajectory.velocity).max())
        length = length or float(np.abs(trajectory.position).max()) or 1.0
        return cls(length, speed or length / float(trajectory.time[-1]), box)

    def apart(self, a: Trajectory, b: Trajectory) -> tuple[FloatArray, FloatArray]:
        """Return two rms distances between the runs at each common sample.

        These are the distances of positions, relative to `length`, and of velocities, relative to `speed`.
        """
        count = min(len(a), len(b))
        d = a.position[:count] - b.position[:count]
        if self.box is not None:
            d = minimum_images(d, self.box)
        return _rms(d) / self.length, _rms(a.velocity[:count] - b.velocity[:count]) / self.speed


def spread(vectors: FloatArray) -> FloatArray:
    """Return the rms distance of (K, n, 3) vectors from their mean, (K,)."""
    return _rms(vectors - vectors.mean(axis=1, keepdims=True))


def compare(run: Trajectory, reference: Trajectory, scale: ErrorScale, samples: int, whole: bool) -> Errors:
    """Compare a run with a reference: trajectories at some samples up to the horizon, and statistics.

    The statistics cover the whole run if the reference reaches the end of the scene (``whole``).
    """
    position, velocity = scale.apart(run.until(samples), reference.until(samples))
    horizon = float(reference.time[samples - 1]) if samples else 0.0
    impact, missed = _late(run, reference, horizon)
    count = min(len(run), len(reference))
    dispersion = spread(run.velocity[:count]) - spread(reference.velocity[:count])
    size = spread(run.position[:count]) - spread(reference.position[:count])
    box = scale.box is not None
    return Errors(
        **_over_time("position", position, samples == len(reference)),
        **_over_time("velocity", velocity, samples == len(reference)),
        **_over_time("size", size[:0] if box else size / scale.length, whole and count == len(reference)),
        **_over_time("dispersion", dispersion / scale.speed, whole and count == len(reference)),
        impact=impact,
        missed=missed,
        energy=run.energy_error,
        energy_gain=run.energy_gain,
        momentum=run.momentum_error,
        angular_momentum=run.angular_momentum_error,
        overlap=run.overlap,
        sinking=run.sinking,
        impacts=abs(run.impacts / reference.impacts - 1.0) if whole and reference.impacts else np.nan,
    )


def _over_time(name: str, errors: FloatArray, reaches_end: bool) -> dict[str, float]:
    """Return the measures of an error over the samples; ``reaches_end``: whether the last sample is the end."""
    largest = float(np.abs(errors).max()) if len(errors) else np.nan
    end = float(abs(errors[-1])) if len(errors) and reaches_end else np.nan
    return {name: _total(errors), f"{name}_max": largest, f"{name}_end": end}


def _late(run: Trajectory, reference: Trajectory, horizon: float) -> tuple[float, float]:
    """Return the rms error (s) of the first contacts up to the horizon, and the number of pairs without contact."""
    met = {tuple(pair): time for pair, time in zip(run.pair.tolist(), run.met.tolist(), strict=True)}
    due = [
        (tuple(pair), time)
        for pair, time in zip(reference.pair.tolist(), reference.met.tolist(), strict=True)
        if time <= horizon
    ]
    if not due:
        return np.nan, np.nan
    late = np.array([min(met.get(pair, horizon), horizon) - time for pair, time in due])
    return _total(late), float(sum(met.get(pair, np.inf) > horizon for pair, _ in due))


def _rms(vectors: FloatArray) -> FloatArray:
    """Return the rms length of (K, n, 3) vectors over the bodies, (K,)."""
    return np.asarray(np.sqrt(np.mean(np.sum(vectors * vectors, axis=2), axis=1)))


def _total(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values * values))) if len(values) else np.nan


ORDER_MATTERS = 1e-10  # smallest relative difference of speeds, beyond rounding, for which the order of impacts matters
AGREEMENT = 1e-3  # distance, in sizes of the system, at which refinements disagree
LOOSER = 10.0  # ratio of the tolerances of the second and the first exact solution
GAIN = 1.1  # refinement ends when it extends the horizon by a smaller factor
BUDGET = 120.0  # s, computing time for a reference
# largest number of bodies for which the reference of a scene with a tree is a direct sum; above, `FINE_ANGLE` applies
DIRECT_UP_TO = 20_000
FINE_ANGLE = 0.2  # rad; the tree's error is a twentieth of its error at the default angle

Teller = Callable[[str], None]


@dataclass(frozen=True, slots=True)
class Reference:
    """A reference and its range of validity."""

    trajectory: Trajectory
    scale: ErrorScale
    kind: str  # "exact" or "refined"
    fineness: float  # ratio of the scene's step to the reference's step; infinite if the reference is exact
    samples: int  # number of samples up to the horizon, at which positions are compared
    whole: bool  # whether the reference reaches the end of the scene
    # for each kind of error, the larger error of the two checks, measured like errors of settings; at least rounding
    uncertainty: Errors
    text: str  # description of the reference
    pile: Pile | None = None  # pile whose settled state is also compared

    @property
    def horizon(self) -> float:
        """The horizon in s, up to which trajectories are compared."""
        return float(self.trajectory.time[self.samples - 1]) if self.samples else 0.0

    @property
    def is_complete(self) -> bool:
        """Whether trajectories are compared up to the end of the scene."""
        return self.whole and self.samples == len(self.trajectory)

    def errors(self, run: Trajectory) -> Errors:
        """Return the errors of a run relative to this reference."""
        found = compare(run, self.trajectory, self.scale, self.samples, self.whole)
        return replace(found, **self.pile.errors(run, self.trajectory)) if self.pile else found


def make_reference(
    scene: Scene, finest: float = 1.0, *, threads: int | None = None, budget: float = BUDGET, tell: Teller | None = None
) -> Reference:
    """Make the reference of a scene. Raises SceneError or PhysicsError if a run fails.

    A refined reference begins with half of the smallest compared step, which is the scene's step divided by ``finest``.
    If the next solution, with half the step, would exceed the ``budget`` (s of computing), the check has twice the step
    instead. An exact solution ends after a third of the budget. ``tell`` receives a sentence before each solution.
    """
    tell = tell or (lambda text: None)
    reason = why_not(scene)
    if not why_no_ball(scene):
        ball, reason = _ball(scene, tell)
        if ball is not None:
            return ball
    elif not reason:
        reference, reason = _exact(scene, threads, budget, tell)
        if reference is not None:
            return reference
    return _refined(scene, finest, threads, budget, tell, reason)


def refined(scene: Scene, factor: float) -> list[str]:
    """Return the overrides that divide the steps of a scene by a factor, whichever limit sets them."""
    rule, units = scene.time, scene.unit_system
    if rule.fixed_dt is not None:
        return [f"time.fixed_dt={units.literal(rule.fixed_dt / factor, TIME)}"]
    shortest = f"time.max_dt={units.literal(_largest_step(scene) / factor, TIME)}"
    if auto.integrator(scene).controls_error:
        return [shortest]
    finer = [shortest]
    if (fraction := auto.cfl(scene)) is not None:
        finer.append(f"time.cfl={fraction / factor!r}")
    if (distance := auto.target_dx(scene)) is not None:
        finer.append(f"time.target_dx={units.literal(distance / factor**2, LENGTH)}")
    if (fraction := auto.pull_fraction(scene)) is not None:
        finer.append(f"time.pull_fraction={fraction / factor!r}")
    return finer


def _largest_step(scene: Scene) -> float:
    """Return the largest step in s; without a limit, the time between automatic frames."""
    largest = auto.largest_step(scene)
    return largest if math.isfinite(largest) else auto.auto_interval(scene, scene.time.duration)


def fineness(scene: Scene, setting: Scene) -> float:
    """Return the ratio of the scene's steps to a setting's steps, for the limit that shrank most.

    The ratio is 1 if an integrator chooses its steps by its own error, since no limit then changes the steps.
    """
    if auto.integrator(scene).controls_error or auto.integrator(setting).controls_error:
        return 1.0
    base, rule = scene.time, setting.time
    if base.fixed_dt is not None or rule.fixed_dt is not None:
        return (base.fixed_dt or _largest_step(scene)) / (rule.fixed_dt or _largest_step(setting))
    finer = [_largest_step(scene) / _largest_step(setting)]
    for limit, power in ((auto.cfl, 1.0), (auto.target_dx, 0.5), (auto.pull_fraction, 1.0)):
        coarse, fine = limit(scene), limit(setting)
        if coarse is not None and fine is not None:
            finer.append((coarse / fine) ** power)
    return max(finer)


def scale_of(scene: Scene, trajectory: Trajectory) -> ErrorScale:
    """Return the scale of a reference of a scene."""
    box = None if scene.domain.period is None else np.array(scene.domain.period)
    return ErrorScale.of(trajectory, box)


def _ball(scene: Scene, tell: Teller) -> tuple[Reference | None, str]:
    """Return the exact reference of a ball and planes, with checks displaced by rounding; or why there is none."""
    times, start = sample_times(scene), place(scene)
    tell("reference: exact, closed forms of a ball on planes")
    best = solve_ball(scene, start, times)
    if best.ended:
        return None, best.ended
    checks = [solve_ball(scene, start, times, nudge=nudge).trajectory for nudge in (1, -1)]
    text = f"exact: closed forms of a ball on planes, {counted(best.impacts, 'impact')}"
    return _reference(scene, best.trajectory, checks, kind="exact", fineness=math.inf, whole=True, text=text), ""


def _exact(scene: Scene, threads: int | None, budget: float, tell: Teller) -> tuple[Reference | None, str]:
    """Return the exact reference of a scene; None and the reason if no sample is certain."""
    times = sample_times(scene)
    tell(f"reference: exact, DOP853 with tolerances of {TIGHTEST:g}")
    best = solve(Space(scene, threads), times, budget=budget / 3)
    known = best.trajectory.time
    if not len(known):
        return None, best.ended
    checks = []
    for twin, tolerance in enumerate((TIGHTEST, LOOSER * TIGHTEST), start=1):
        if len(known):
            tell(f"reference: exact, check {twin} of 2, up to t = {scene.unit_system.text(known[-1], TIME)}")
            checks.append(solve(Space(scene, threads), known, tolerance, twin=twin, budget=budget / 2).trajectory)
    text = f"exact: DOP853, tolerance {TIGHTEST:g}, {counted(len(best.time), 'contact')} located"
    text += f"; it ends early: {best.ended}" if best.ended else ""
    whole = not best.ended
    text += _undetermined(scene, best, checks)
    reference = _reference(scene, best.trajectory, checks, kind="exact", fineness=math.inf, whole=whole, text=text)
    return (reference, "") if reference.samples else (None, f"no sample is certain: {text}")


def _undetermined(scene: Scene, best: EventDrivenSolution, checks: list[Trajectory]) -> str:
    """Name the simultaneous impacts whose order decides the solution; empty if there are none."""
    scale = scale_of(scene, best.trajectory)
    for check in checks:
        _, apart = scale.apart(best.trajectory, check)
        for time in best.together:
            after = int(np.searchsorted(best.trajectory.time, time, side="right"))
            if 0 < after < len(apart) and apart[after] > ORDER_MATTERS and apart[after] > 10.0 * apart[after - 1]:
                when = scene.unit_system.text(time, TIME)
                return (
                    f"; velocities after the simultaneous impacts at t = {when} depend on their order, "
                    f"by {apart[after]:.1e} of the speed, and no law determines it"
                )
    return ""


def _refined(scene: Scene, finest: float, threads: int | None, budget: float, tell: Teller, reason: str) -> Reference:
    pile = Pile.of(scene)
    times, factor, watch = sample_times(scene), 2.0 * finest, Stopwatch()
    tell(f"reference: steps {factor:g} times smaller")
    coarse = follow(_space(scene, factor, threads), times)
    reference: Reference | None = None
    _, of_gravity = _finer_gravity(scene)
    # s, time of a pile's runs with other seeds, which have the steps of the scene
    seeds = 0.0 if pile is None else SEEDS * watch.seconds / factor
    check_is_coarser = 3.0 * watch.seconds + seeds > budget  # a check with half the step would take too long
    while True:
        factor, started = 2.0 * factor, watch.seconds
        if check_is_coarser:
            factor /= 2.0
            tell("reference: its check, with twice the step")
            fine, coarse = coarse, follow(_space(scene, factor / 2.0, threads), times)
        else:
            tell(f"reference: steps {factor:g} times smaller")
            fine = follow(_space(scene, factor, threads), times)
        text = f"refined: the scene with steps {factor:g} and {factor / 2:g} times smaller{of_gravity} ({reason})"
        found = _reference(scene, fine, [coarse], kind="refined", fineness=factor, whole=True, text=text)
        gained = reference is None or found.samples > GAIN * reference.samples
        reference, coarse = found, fine
        now = watch.seconds
        if (
            check_is_coarser
            or found.samples == len(times)
            or not gained
            or now + 2.0 * (now - started) + seeds > budget
        ):
            return _with_pile(scene, pile, reference, coarse, threads, tell)


def _with_pile(
    scene: Scene, pile: Pile | None, reference: Reference, check: Trajectory, threads: int | None, tell: Teller
) -> Reference:
    """Add the settled pile, with its scatter between seeds, to a reference that becomes uncertain during the run."""
    if pile is None or reference.is_complete:
        return reference
    others = []
    for seed in range(scene.seed + 1, scene.seed + 1 + SEEDS):
        tell(f"reference: the scatter of settled piles, seed {seed}")
        other = scene.changed([f"seed={seed}"])
        bodies = Pile.of(other)
        assert bodies is not None  # the seed does not change the bodies
        others.append(bodies.settled(follow(Space(other, threads), reference.trajectory.time)))
    apart = pile.errors(check, reference.trajectory)
    scatter = pile.scatter(others, reference.trajectory)
    uncertainty = replace(reference.uncertainty, **{name: max(scatter[name], apart[name]) for name in scatter})
    text = f"{reference.text}; the settled pile is compared, too, with the scatter of {SEEDS} other seeds"
    return replace(reference, uncertainty=uncertainty, text=text, pile=pile)


def _space(scene: Scene, factor: float, threads: int | None) -> Space:
    """Return the scene with smaller steps and no error of a tree; without forces, also with exact times of impact."""
    overrides = refined(scene, factor) + _finer_gravity(scene)[0]
    if not require(scene).accelerates:
        overrides += ["contact.timing=time-of-impact", "time.integrator=leapfrog"]
    return Space(scene.changed(overrides), threads)


def _finer_gravity(scene: Scene) -> tuple[list[str], str]:
    """Return the overrides that remove the error of a tree, and their description."""
    if not auto.uses_tree(scene):
        return [], ""
    if scene.count <= DIRECT_UP_TO:
        return ["gravity.method=direct"], ", and a direct sum"
    return [f"gravity.opening_angle={FINE_ANGLE}"], f", and an opening angle of {FINE_ANGLE}"


def _reference(
    scene: Scene, best: Trajectory, checks: list[Trajectory], *, kind: str, fineness: float, whole: bool, text: str
) -> Reference:
    scale = scale_of(scene, best)
    samples = 0 if not checks else len(best)  # number of samples up to the first divergence of a check
    for check in checks:
        apart, _ = scale.apart(best, check)
        diverged = np.flatnonzero(~(apart <= AGREEMENT))
        samples = min(samples, int(diverged[0]) if len(diverged) else len(apart))
    errors = [compare(check, best, scale, samples, whole) for check in checks]
    horizon = float(best.time[samples - 1]) if samples else 0.0
    if samples < len(best):
        why = "rounding or the order of simultaneous contacts decides" if kind == "exact" else "the check differs"
        text += f"; after t = {scene.unit_system.text(horizon, TIME)} {why}"
    return Reference(best, scale, kind, fineness, samples, whole, _largest(errors, horizon), text)


def _largest(errors: list[Errors], horizon: float) -> Errors:
    """Return the largest value of each error, but at least rounding; for times of impact, the rounding of the clock."""
    rows = [astuple(error) for error in errors] or [(math.nan,) * len(NAMES)]
    largest = Errors(*np.fmax.reduce(np.array(rows), axis=0).tolist())
    rounding = dict.fromkeys(OF_SAMPLES, EPS) | {"impact": EPS * horizon}
    return replace(largest, **{name: max(getattr(largest, name), least) for name, least in rounding.items()})
