"""`Branch`: a recording to fork, when to fork it, and the new parameters; it runs in this process or on workers."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from carom.arrays import FloatArray, SingleArray
from carom.errors import ExperimentError, RecordingError
from carom.lab.run_summary import Expression, Observation, Touches, UnknownNameError
from carom.physics.schedule import Every
from carom.physics.space import Space
from carom.physics.vector import minimum_images
from carom.plan import auto
from carom.plan.features import require
from carom.recording.read.lookup import goal_of
from carom.recording.read.recorded_scene import recorded_scene
from carom.recording.read.recording import Recording
from carom.runs.resume import continued_scene
from carom.runs.window import checkpoint_before, space_of
from carom.runs.workers import Workers
from carom.scene.load import Scene
from carom.scene.units.dimension import TIME
from carom.state.checkpoint import Checkpoint
from carom.state.energies import EnergyBaseline, Origin

_BODIES = ("body", "bodies", "group", "seed", "units", "title", "description")
_STATE = {
    "domain": "the positions of the bodies depend on it",
    "outlet": "bodies have left through it",
    "sweep": "one fork is one run",
}


@dataclass(frozen=True, slots=True)
class Branch:
    """The data with which a worker continues a recording from a given time."""

    path: Path
    at: float  # s
    overrides: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class ForkStart:
    """The initial state and the scene of a branch."""

    recording: Recording
    scene: Scene
    checkpoint: Checkpoint

    def space(self, threads: int | None = None, shift: int | None = None, ulps: int = 1) -> Space:
        """Build a space at the fork.

        ``shift`` is the seed of a perturbation, if any: each coordinate then moves by ``ulps`` units in the last place,
        up or down.
        """
        checkpoint = self.checkpoint
        if shift is not None:
            position = checkpoint.position
            up = np.random.default_rng(shift).integers(0, 2, position.shape).astype(bool)
            for _ in range(ulps):
                position = np.where(up, np.nextafter(position, np.inf), np.nextafter(position, -np.inf))
            checkpoint = replace(checkpoint, position=np.ascontiguousarray(position))
        records = self.recording.records_contacts
        space = space_of(self.recording, self.scene, checkpoint, threads, False, records)
        if checkpoint.step and self.recording.entries is not None:
            return _with_books(space, checkpoint)
        begun = space.frame().checkpoint  # a checkpoint with the forces of the new parameters at this state
        space.restore(
            replace(checkpoint, acceleration=begun.acceleration, energy=begun.energy, books=begun.books)
            if checkpoint.step
            else begun
        )
        return space


def _with_books(space: Space, checkpoint: Checkpoint) -> Space:
    """Restore a checkpoint with bodies that may still wait to enter; begin its books anew, with the new forces."""
    fresh = space.frame().checkpoint  # a fresh state, as if no body had entered or left
    space.restore(replace(checkpoint, energy=fresh.energy, books=fresh.books))
    acceleration, now = space.accelerated(), space.frame().energy
    origin = Origin(now.translational + now.gravitational, now.rotational, now.field)
    books = replace(fresh.books, energy=EnergyBaseline(now.total, fresh.books.energy.scale, origin))
    space.restore(replace(checkpoint, acceleration=acceleration, energy=fresh.energy, books=books))
    return space


def start_of(branch: Branch) -> ForkStart:
    """Return the state at the end of the step that contains the time of the fork.

    Refuse recordings that cannot be run again, and overrides that change properties stored in a checkpoint.
    """
    recording = Recording.open(branch.path)
    recording.refuse_overlay()
    recording.refuse_some_bodies()
    original = recorded_scene(recording)
    # some keys only set the initial state or the domain
    for override in branch.overrides:
        key = override.partition("=")[0].strip()
        section = key.partition(".")[0]
        if section in _BODIES:
            raise ExperimentError(
                f"--set {override}: a fork uses the bodies of the checkpoint, so {key} has no effect; change "
                "parameters of forces, contacts or steps, or run the scene from the start"
            )
        if section in _STATE:
            raise ExperimentError(f"--set {override}: {key} cannot change in the middle of a run: {_STATE[section]}")
    scene = continued_scene(recording, original, list(branch.overrides)) if branch.overrides else original
    checkpoint = _checkpoint_at(recording, original, recording.moment(branch.at))
    # refuse overrides that change which arrays a checkpoint holds
    before, after = require(original), require(scene)
    changes = {
        "whether bodies spin": (before.spin.modelled, after.spin.modelled),
        "whether bodies have orientations": (before.orientation.modelled, after.orientation.modelled),
        "whether bodies can touch": (before.contact.modelled, after.contact.modelled),
        "the solver of resting contacts": (original.contact.solver, scene.contact.solver),
        "the integrator": (auto.integrator(original).name, auto.integrator(scene).name),
        "the number of planes": (len(original.plane), len(scene.plane)),
        "the number of walls": (len(original.wall), len(scene.wall)),
    }
    for what, (one, other) in changes.items():
        if one != other:
            raise ExperimentError(
                f"--set {' --set '.join(branch.overrides)}: this changes {what}, on which a checkpoint depends; run "
                "the scene from the start with `carom run`"
            )
    end, units = scene.time.duration, scene.unit_system
    if checkpoint.time >= end:
        raise ExperimentError(
            f"the run ends at {units.text(end, TIME, 'g')}: a fork at t = {units.text(checkpoint.time, TIME, '.9g')} "
            "would have no time left. Give an earlier --at, or a later end with --set time.duration=…"
        )
    return ForkStart(recording, scene, checkpoint)


def _checkpoint_at(recording: Recording, scene: Scene, time: float) -> Checkpoint:
    """Rerun from the last checkpoint before a time (s), up to the step that contains it."""
    checkpoint = checkpoint_before(recording, time)
    goal = goal_of(recording, time)
    if checkpoint.time >= goal:
        return checkpoint
    space = space_of(recording, scene, checkpoint, record_contacts=recording.records_contacts)
    for frame in space.run(schedule=lambda step, before, now: now >= goal):
        if frame.time >= goal:
            return frame.checkpoint
    raise RecordingError(f"{recording.path} ends before {scene.unit_system.text(time, TIME, '.9g')} when it is rerun")


OPTION = "--outcome"
MOST_FRAMES = 200
_MULTIPLE = 1e-9  # relative tolerance of multiples, as in `Every`
_MOMENTS = "moments."  # prefix of summary keys that exist only after the event has happened


@dataclass(frozen=True, slots=True)
class BranchPath:
    """Positions at multiples of an interval and at the end, and whether an outcome occurred."""

    time: FloatArray  # (k,) s
    position: FloatArray  # (k, n, 3) m
    outcome: bool | None  # None if no outcome is requested


def path_of(
    start: ForkStart, shift: int | None, ulps: int, outcome: Expression | None, threads: int | None = 1
) -> BranchPath:
    """Run a branch to its end.

    Branches are compared at the end, and at multiples of the frame interval, or of a longer interval if there are many
    frames. Each branch has a frame after the first step that reaches a multiple. The steps of branches differ, so the
    bodies of such a frame are moved back along their velocities to the exact multiple of the interval.
    """
    begin, end = start.checkpoint.time, start.scene.time.duration
    interval = float(max(auto.frame_interval(start.scene), (end - begin) / MOST_FRAMES))
    space = start.space(threads, shift, ulps)
    first, last = (int(np.floor(time / interval * (1.0 + _MULTIPLE))) for time in (begin, end))
    time = interval * np.arange(first + 1, last + 1).astype(np.float64)
    if not len(time) or time[-1] * (1.0 + _MULTIPLE) < end:
        time = np.append(time, end)
    position = np.full((len(time), *space.state.position.shape), np.nan)
    seen, initial, count, filled = Touches(space), space.status.energy.total, 0, 0
    for frame in space.run(schedule=Every(interval)):
        count += 1
        if outcome is not None:
            seen.see(frame)
        reached = int(np.searchsorted(time, frame.time * (1.0 + _MULTIPLE), side="right"))
        for row in range(filled, reached):  # a long step passes several multiples
            position[row] = frame.position - frame.velocity * (frame.time - time[row])
        filled = max(filled, reached)
    came = None
    if outcome is not None:
        summary = _summary(outcome, space, Observation(space, initial, count, [], seen))
        try:
            came = outcome.holds(summary)
        except UnknownNameError as error:
            raise ExperimentError(_explained(outcome, error.name, summary, len(space.state))) from None
    return BranchPath(time, position, came)


def outcome_of(start: ForkStart, text: str) -> Expression:
    """Parse an outcome; raise ExperimentError before any branch is run if it uses a name that no branch will have."""
    outcome, space = Expression(text, OPTION), start.space()
    summary = _summary(outcome, space, Observation(space, space.status.energy.total, 0, [], Touches(space)))
    for name in outcome.unknown(summary):
        if not name.startswith(_MOMENTS):
            raise ExperimentError(_explained(outcome, name, summary, len(space.state)))
    return outcome


def _summary(outcome: Expression, space: Space, seen: Observation) -> dict[str, Any]:
    position = space.state.position
    # values of single bodies in the outcome have names such as ``x_3``, in m, and ``speed_3``, in m/s
    found: dict[str, float] = {}
    for name in outcome.names:
        what, _, number = name.partition("_")
        if number.isdigit() and int(number) < len(position):
            body = int(number)
            if what in ("x", "y", "z"):
                found[name] = float(position[body, "xyz".index(what)])
            elif what == "speed":
                found[name] = float(np.linalg.norm(space.state.velocity[body]))
    return seen.summary | found


def _explained(outcome: Expression, name: str, summary: Mapping[str, Any], bodies: int) -> str:
    """Return the message about an unknown name or body in an outcome."""
    if re.fullmatch(r"([xyz]|speed)_\d+", name):
        body = name.partition("_")[2]
        return f"{OPTION} {outcome.text}: there is no body {body} for {name}; the last is {bodies - 1}"
    return outcome.explain_unknown(name, summary)


_TICK = 60.0  # s, longest single wait for results
_STARTS = 4  # number of moments and reference paths that a worker keeps


@dataclass(frozen=True, slots=True)
class PerturbedTask:
    """One perturbed branch."""

    branch: Branch
    seed: int
    ulps: int
    outcome: str | None


@dataclass(frozen=True, slots=True)
class PerturbedResult:
    """Distances of bodies in a perturbed branch from their counterparts in the unperturbed branch."""

    seed: int
    apart: SingleArray  # (k, n) m
    outcome: bool | None


def results_of(tasks: Iterable[PerturbedTask], workers: Workers) -> Iterator[PerturbedResult]:
    """Yield results as they arrive; tasks that still wait are cancelled when the caller stops."""
    left = {task.seed: task for task in tasks}
    workers.send(execute, left)
    try:
        while left:
            for ended in workers.ended(_TICK):
                del left[ended.key]
                yield ended.result
    finally:
        workers.drop()


def by_seed(results: Iterable[PerturbedResult]) -> Iterator[PerturbedResult]:
    """Yield results in the order of their seeds, from 1, so that a test's result does not depend on workers."""
    waiting: dict[int, PerturbedResult] = {}
    seed = 1
    for result in results:
        waiting[result.seed] = result
        while seed in waiting:
            yield waiting.pop(seed)
            seed += 1


def execute(task: PerturbedTask) -> PerturbedResult:
    """Run one branch."""
    start, reference = _prepared(task.branch)
    outcome = None if task.outcome is None else Expression(task.outcome, OPTION)
    path = path_of(start, task.seed, task.ulps, outcome)
    distances = apart(path.position, reference.position, path.time, start)
    return PerturbedResult(task.seed, distances.astype(np.float32), path.outcome)


def apart(a: FloatArray, b: FloatArray, times: FloatArray, start: ForkStart) -> FloatArray:
    """Return the distances of counterparts at some times (s), (k, n) m, between nearest images in a periodic box."""
    off, domain = a - b, start.scene.domain
    if domain.period is not None:
        size = np.array(domain.period)
        cells = [domain.shear.cell(size, time) if domain.shear else size for time in times.tolist()]
        off = np.stack([minimum_images(each, cell) for each, cell in zip(off, cells, strict=True)])
    return np.asarray(np.sqrt((off * off).sum(axis=2)))


@lru_cache(_STARTS)
def _prepared(branch: Branch) -> tuple[ForkStart, BranchPath]:
    start = start_of(branch)
    return start, path_of(start, None, 0, None)
