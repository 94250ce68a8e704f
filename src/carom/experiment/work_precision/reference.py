"""What the settings of a scene are measured against: the exact course of a few bodies, or the scene itself, refined.

A few bodies in open space are solved exactly (`event_driven_reference.py`), and twice more as checks. Both checks start
displaced by rounding errors, so that they show how fast chaos separates the runs; one has a tolerance ten times looser.
Other scenes are run with ever smaller steps, each half of the one before. Where nothing pulls, flight is exact and only
the times of impacts can be wrong, so these runs use times of impact. The last run is the reference, and the one before
it the check.

The reference is trusted up to the *horizon*, where a check first deviates by more than a thousandth of the size of the
system, and there to within the largest error of a check. Beyond it only statistics can be compared.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import astuple, dataclass, replace

import numpy as np
from numpy.typing import NDArray

from carom.experiment.work_precision.error_measures import NAMES, Errors, Scale, compare
from carom.experiment.work_precision.event_driven_reference import TIGHTEST, solve, why_not
from carom.experiment.work_precision.trajectory import Trajectory, follow, sample_times
from carom.physics.space import Space
from carom.plan.auto import cfl, gravity_method, integrator, pull_fraction, target_dx
from carom.plan.features import require
from carom.scene.load import scene_from_text
from carom.scene.schema import Scene

FloatArray = NDArray[np.float64]

AGREEMENT = 1e-3  # of the size of the system: two refinements that are farther apart no longer agree
LOOSER = 10.0  # the tolerance of the second exact solution over that of the first
GAIN = 1.1  # a refinement whose horizon is not longer by so much is the last
BUDGET = 120.0  # s of computing, for all exact solutions; beyond it no further refinement is begun after the second
EPS = float(np.finfo(np.float64).eps)  # nothing computed in double precision is known to less than this part of it

DIRECT_UP_TO = 20_000  # bodies whose pulls the reference of a tree sums one by one; of more it opens more boxes
FINE_ANGLE = 0.2  # rad, at which a tree errs by a twentieth of what it does at its default

Teller = Callable[[str], None]


@dataclass(frozen=True, slots=True)
class Reference:
    """A reference, and how far it is to be trusted."""

    trajectory: Trajectory
    scale: Scale
    kind: str  # "exact" or "refined"
    fineness: float  # how many times smaller its steps are than those of the scene; infinite where it is exact
    samples: int  # at which positions are compared: up to the horizon
    whole: bool  # whether it goes to the end of the scene
    uncertainty: Errors  # the errors of the checks by the same measures as any setting, the larger; at least rounding
    text: str  # what it is, for people

    @property
    def horizon(self) -> float:
        """Up to when trajectories are compared, in s."""
        return float(self.trajectory.time[self.samples - 1]) if self.samples else 0.0

    def errors(self, run: Trajectory) -> Errors:
        """Hold a run against it."""
        return compare(run, self.trajectory, self.scale, self.samples, self.whole)


def make_reference(
    scene: Scene, finest: float = 1.0, *, threads: int | None = None, budget: float = BUDGET, tell: Teller | None = None
) -> Reference:
    """Make the reference of a scene.

    Parameters
    ----------
    finest
        How many times smaller than the scene's the smallest steps are that will be compared; a refined reference begins
        at half of those.
    threads
        For the kernels.
    budget
        Seconds of computing: an exact course ends where a third of it is used up, and after all of it no refinement is
        begun but the second.
    tell
        Called with a sentence before each solution.

    Raises
    ------
    SceneError, PhysicsError
        If the scene cannot run, or a run stops being finite.
    """
    tell = tell or (lambda text: None)
    reason = why_not(scene)
    if not reason:
        reference = _exact(scene, threads, budget, tell)
        if reference.samples:
            return reference
        reason = f"no sample is certain of what is {reference.text}"
    return _refined(scene, finest, threads, budget, tell, reason)


def refined(scene: Scene, factor: float) -> list[str]:
    """Return the overrides that make a scene's steps that many times smaller, whatever rule sets them."""
    rule = scene.time
    if integrator(scene).controls_error and rule.fixed_dt is None:
        return [f"time.max_dt={rule.max_dt / factor!r}"]
    if rule.fixed_dt is not None:
        return [f"time.fixed_dt={rule.fixed_dt / factor!r}"]
    limits = {
        "cfl": (cfl(scene), factor),
        "target_dx": (target_dx(scene), factor**2),
        "pull_fraction": (pull_fraction(scene), factor),
    }
    finer = [f"time.{key}={limit / by!r}" for key, (limit, by) in limits.items() if limit is not None]
    return [f"time.max_dt={rule.max_dt / factor!r}", *finer]


def fineness(scene: Scene, setting: Scene) -> float:
    """Return how many times smaller a setting's steps are than those of the scene, by the limit that shrank most."""
    base, rule = scene.time, setting.time
    if base.fixed_dt is not None or rule.fixed_dt is not None:
        return (base.fixed_dt or base.max_dt) / (rule.fixed_dt or rule.max_dt)
    finer = [base.max_dt / rule.max_dt]
    for limit, power in ((cfl, 1.0), (target_dx, 0.5), (pull_fraction, 1.0)):
        coarse, fine = limit(scene), limit(setting)
        if coarse is not None and fine is not None:
            finer.append((coarse / fine) ** power)
    return max(finer)


def scale_of(scene: Scene, trajectory: Trajectory) -> Scale:
    """Take the scale of a reference of a scene."""
    box = np.array(scene.domain.size) if scene.domain.boundary == "periodic" else None
    return Scale.of(trajectory, box)


def _exact(scene: Scene, threads: int | None, budget: float, tell: Teller) -> Reference:
    times = sample_times(scene)
    tell(f"reference: exact, DOP853 with tolerances of {TIGHTEST:g}")
    best = solve(Space(scene, threads), times, budget=budget / 3)
    known = best.trajectory.time
    checks = []
    for twin, tolerance in enumerate((TIGHTEST, LOOSER * TIGHTEST), start=1):
        if len(known):
            tell(f"reference: exact, check {twin} of 2, up to t = {known[-1]:.6g} s")
            checks.append(solve(Space(scene, threads), known, tolerance, twin=twin, budget=budget / 2).trajectory)
    text = f"exact: DOP853, tolerance {TIGHTEST:g}, {len(best.time)} contacts located"
    return _reference(
        scene,
        best.trajectory,
        checks,
        kind="exact",
        fineness=math.inf,
        whole=not best.ended,
        text=text + (f"; it ends early: {best.ended}" if best.ended else ""),
    )


def _refined(scene: Scene, finest: float, threads: int | None, budget: float, tell: Teller, reason: str) -> Reference:
    times, factor, began = sample_times(scene), 2.0 * finest, time.perf_counter()
    tell(f"reference: steps {factor:g} times smaller")
    coarse = follow(_space(scene, factor, threads), times)
    reference: Reference | None = None
    _, of_the_pull = _finer_pull(scene)
    while True:
        factor, started = 2.0 * factor, time.perf_counter()
        tell(f"reference: steps {factor:g} times smaller")
        fine = follow(_space(scene, factor, threads), times)
        found = _reference(
            scene,
            fine,
            [coarse],
            kind="refined",
            fineness=factor,
            whole=True,
            text=f"refined: the scene with steps {factor:g} and {factor / 2:g} times smaller{of_the_pull} ({reason})",
        )
        gained = reference is None or found.samples > GAIN * reference.samples
        reference, coarse = found, fine
        now = time.perf_counter()
        if found.samples == len(times) or not gained or now - began + 2.0 * (now - started) > budget:
            return reference


def _space(scene: Scene, factor: float, threads: int | None) -> Space:
    """Return the scene with smaller steps, without a tree's error, and where nothing pulls with times of impact."""
    overrides = refined(scene, factor) + _finer_pull(scene)[0]
    if not require(scene).pulls:
        overrides += ["contact.timing=time-of-impact", "time.integrator=leapfrog"]
    return Space(scene_from_text(scene.toml, scene.title, overrides), threads)


def _finer_pull(scene: Scene) -> tuple[list[str], str]:
    """Return the overrides that take a tree's error away, and what to say of it."""
    if gravity_method(scene) != "tree":
        return [], ""
    if scene.count <= DIRECT_UP_TO:
        return ["gravity.method=direct"], ", and a direct sum"
    return [f"gravity.opening_angle={FINE_ANGLE}"], f", and an opening angle of {FINE_ANGLE}"


def _reference(
    scene: Scene, best: Trajectory, checks: list[Trajectory], *, kind: str, fineness: float, whole: bool, text: str
) -> Reference:
    scale = scale_of(scene, best)
    samples = min((_agreement(scale, best, check) for check in checks), default=0)
    errors = [compare(check, best, scale, samples, whole) for check in checks]
    horizon = float(best.time[samples - 1]) if samples else 0.0
    return Reference(best, scale, kind, fineness, samples, whole, _largest(errors, horizon), text)


def _agreement(scale: Scale, best: Trajectory, check: Trajectory) -> int:
    """Count the samples before two solutions part."""
    apart, _ = scale.apart(best, check)
    parted = np.flatnonzero(~(apart <= AGREEMENT))
    return int(parted[0]) if len(parted) else len(apart)


def _largest(errors: list[Errors], horizon: float) -> Errors:
    """Return the largest of each error, at least rounding: of the time of an impact, that of the clock."""
    rows = [astuple(error) for error in errors] or [(math.nan,) * len(NAMES)]
    largest = Errors(*np.fmax.reduce(np.array(rows), axis=0).tolist())
    return replace(
        largest,
        position=max(largest.position, EPS),
        velocity=max(largest.velocity, EPS),
        impact=max(largest.impact, EPS * horizon),
        size=max(largest.size, EPS),
        dispersion=max(largest.dispersion, EPS),
    )
