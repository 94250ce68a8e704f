"""The data by which runs are compared: states at common times, first contacts and extremes.

Common times fall within steps, and cutting steps at these times would change the run. Within a step, a body is
therefore assumed to fly freely, with a correction that leads to its state at the end of the step. The correction is a
polynomial of degree five, or of degree three if the integrator computes no forces at the ends of a step. A body in
contact is corrected by a constant acceleration, because contacts are solved for the mean velocity of a step. After an
impact, a body flies freely until its next impact.
"""

from __future__ import annotations

import hashlib
import json
import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any, Self

import numpy as np

from carom.arrays import FloatArray, IntArray
from carom.errors import ExperimentError, PhysicsError
from carom.physics.schedule import Watch, every, quiet
from carom.physics.space import Space
from carom.physics.vector import minimum_images
from carom.plan import auto
from carom.recording.write.whole_file import whole_file, write_whole
from carom.scene.load import Scene
from carom.scene.units.dimension import TIME
from carom.state.frame import Frame

TELLING = 5.0  # s between two lines of progress
STEPS = (4.0, 2.0, 1.0, 0.5)  # factors on the step for each integrator, in scenes without contacts
SAMPLES = 200  # times at which trajectories are compared
# distance of a sample from a round time, in sampling intervals; the golden section avoids simple ratios
EARLIER = (3.0 - 5.0**0.5) / 2.0
LATE = 0.9  # contacts after this fraction of the samples count as late in the run
ROUNDINGS = 8  # roundings of a coordinate by which displacement and velocities of a body in contact may disagree
MORE_SAMPLES_UP_TO, MORE_SAMPLES = 20, 600  # up to this many bodies, more samples cost nothing, and paths can be drawn


@dataclass(frozen=True, slots=True)
class Setting:
    """A few keys of the scene with changed values."""

    name: str  # a name such as "integrator = euler, steps 2 times as long"
    overrides: tuple[str, ...]  # values of keys, in the form of ``--set``
    threads: int | None = None  # number of threads; None for the number of threads of the study
    engine: str = ""  # name of the other engine whose keys `overrides` contains; empty for carom

    def apply(self, scene: Scene) -> Scene:
        """Return the scene with this setting; SceneError if a key or a value is wrong."""
        return scene.changed(list(self.overrides))


AS_WRITTEN = Setting("as written", ())


class RunStoppedError(ExperimentError):
    """A run was stopped at its limit of CPU time or of steps; ``reached`` is a time with its unit.

    ``option`` is the option that set the limit of CPU time; empty for the limit of steps.
    """

    def __init__(self, steps: int, seconds: float, reached: str, *, option: str) -> None:
        self.steps, self.seconds = steps, seconds
        after = f"{seconds:.3g} s of CPU time ({option})" if option else f"{steps} steps"
        super().__init__(f"stopped after {after}, at t = {reached}")


@dataclass(frozen=True, slots=True)
class RunBound:
    """The limits at which a run is stopped."""

    steps: float = math.inf  # limit on steps, which is the same on every machine
    seconds: float = math.inf  # limit on CPU time, s
    option: str = "--limit"  # name of the option that set the seconds


class RunGuard:
    """Observes a run from its start, decides when it stops, and calls ``tell`` every `TELLING` seconds.

    ``tell`` receives the step and the simulated time in s.
    """

    def __init__(self, bound: RunBound, tell: Callable[[int, float], None]) -> None:
        self._bound, self._tell = bound, tell
        self._began, self._told = time.process_time(), time.perf_counter()

    @property
    def most(self) -> float:
        """The largest number of steps."""
        return self._bound.steps

    @property
    def seconds(self) -> float:
        """CPU time since the start, in s."""
        return time.process_time() - self._began

    def is_over(self, step: int, reached: float) -> bool:
        """Return whether to stop after a step that reached a simulated time in s."""
        if time.perf_counter() - self._told > TELLING:
            self._told = time.perf_counter()
            self._tell(step, reached)
        return step >= self._bound.steps or self.seconds > self._bound.seconds


@dataclass(frozen=True, slots=True)
class Trajectory:
    """Data of a run for comparison; NaN if not measured."""

    time: FloatArray  # (K,) s
    position: FloatArray  # (K, n, 3) m
    velocity: FloatArray  # (K, n, 3) m/s
    pair: IntArray  # (m, 2) bodies that touched, in the order of their first contacts; j ≥ n is plane j - n
    met: FloatArray  # (m,) s, the time of each pair's first contact
    energy_error: float  # largest |integration error|, or energy added by contacts, relative to the energy scale
    energy_gain: float  # largest rise of the total energy above its previous minimum, relative to the energy scale
    momentum_error: float  # largest error of the momentum, relative to its scale
    angular_momentum_error: float  # largest error of the angular momentum, relative to its scale
    overlap: float  # deepest overlap relative to the smaller radius; NaN if no contact is possible
    # mean overlap, relative to the smaller radius, of contacts late in the run; NaN if nothing can be at rest
    sinking: float
    impacts: int  # number of contacts that closed faster than the rest speed, summed over the steps
    steps: int
    frames: int  # frames in a recording of the run; 0 for a reference, which is not recorded
    # (k, 2) both ends of each impact, and (k,) the times of the impacts in s; only exact references have them
    struck: IntArray = field(default_factory=lambda: np.empty((0, 2), np.int64))
    struck_at: FloatArray = field(default_factory=lambda: np.empty(0))

    @classmethod
    def exact(
        cls,
        time: FloatArray,
        position: FloatArray,
        velocity: FloatArray,
        met: Mapping[tuple[int, int], float],
        impacts: int,
        **struck: Any,
    ) -> Trajectory:
        """Return the trajectory of an exact reference, which has no steps, overlaps or measured errors.

        ``met`` is the time (s) of the first contact of each pair, ``position`` and ``velocity`` are (K, n, 3), and
        ``struck`` may contain the fields ``struck`` and ``struck_at``.
        """
        return cls(
            time=time[: len(position)],
            position=position,
            velocity=velocity,
            pair=np.array(list(met), dtype=np.int64).reshape(-1, 2),
            met=np.array(list(met.values())),
            energy_error=np.nan,
            energy_gain=np.nan,
            momentum_error=np.nan,
            angular_momentum_error=np.nan,
            overlap=0.0,
            sinking=0.0,
            impacts=impacts,
            steps=0,
            frames=0,
            **struck,
        )

    def __len__(self) -> int:
        return len(self.time)

    def until(self, count: int) -> Trajectory:
        """Return a copy with the first ``count`` samples, and everything else unchanged."""
        values = {each.name: getattr(self, each.name) for each in fields(self)}
        return Trajectory(**(values | {name: values[name][:count] for name in ("time", "position", "velocity")}))

    @property
    def digest(self) -> str:
        """A digest of steps and states: runs with equal digests are equal, bit for bit."""
        found = hashlib.sha256(str(self.steps).encode())
        for states in (self.position, self.velocity):
            found.update(np.ascontiguousarray(states + 0.0).tobytes())  # + 0 turns -0 into 0
        return found.hexdigest()

    def save(self, path: Path) -> None:
        """Write a ``.npz`` atomically."""
        with whole_file(path) as part:
            np.savez(part, **{each.name: getattr(self, each.name) for each in fields(self)})

    @classmethod
    def load(cls, path: Path) -> Self:
        """Read a file written by `save`. Raises ValueError or OSError for any other file."""
        with np.load(path, allow_pickle=False) as kept:
            missing = [each.name for each in fields(cls) if each.name not in kept]
            if missing:
                raise ValueError(f"{path}: it contains no {missing[0]}")
            values = {each.name: kept[each.name] for each in fields(cls)}
        return cls(**{name: value if value.ndim else value.item() for name, value in values.items()})


def sample_times(scene: Scene) -> FloatArray:
    """Return the times at which trajectories of a scene are compared, (K,) s, up to and including its duration.

    The last fraction is exactly 1, so that no time is rounded past the end of the run. The other times are not round
    numbers: impacts often happen at round times, and a velocity has two values at an impact.
    """
    count = MORE_SAMPLES if scene.count <= MORE_SAMPLES_UP_TO else SAMPLES
    fractions = (np.arange(1, count + 1) - EARLIER) / count
    fractions[-1] = 1.0
    return np.asarray(scene.time.duration * fractions)


def follow(
    space: Space,
    times: FloatArray,
    bound: RunBound = RunBound(),
    tell: Callable[[int, float], None] = lambda step, time: None,
) -> Trajectory:
    """Run a space to its end and sample it at some times, (K,) s, without changing its steps.

    Raises
    ------
    PhysicsError
        If the state is no longer finite.
    RunStoppedError
        If the run exceeds its bound; see `RunGuard` for ``tell``.
    """
    guard = RunGuard(bound, tell)
    watch = _Watch(space, times, guard)
    frames = space.run(schedule=watch)
    next(frames)  # skips the frame at the start
    for frame in frames:
        if watch.is_over:
            reached = space.scene.unit_system.text(space.time, TIME)
            option = bound.option if guard.seconds > bound.seconds else ""
            raise RunStoppedError(space.step, guard.seconds, reached, option=option)
        watch.sample(frame)
    watch.see_contacts(space.time)
    if len(watch.position) < len(times):
        raise PhysicsError(f"the run stopped at t = {space.scene.unit_system.text(space.time, TIME)}")
    extremes, n = space.extremes, len(space.state) + len(space.planes)
    overlap = extremes.overlap.value if extremes.overlap else 0.0
    met = np.array(list(watch.met), dtype=np.int64)
    return Trajectory(
        time=times,
        position=np.array(watch.position),
        velocity=np.array(watch.velocity),
        pair=np.stack((met // n, met % n), axis=1),
        met=np.array(list(watch.met.values())),
        energy_error=extremes.energy_fault.value if extremes.energy_fault else 0.0,
        energy_gain=extremes.energy_gain.value,
        momentum_error=extremes.momentum_error.value if extremes.momentum_error else np.nan,
        angular_momentum_error=extremes.angular_momentum_error.value if extremes.angular_momentum_error else np.nan,
        overlap=overlap if space.requirements.contact.modelled else np.nan,
        sinking=watch.sinking if space.requirements.resting.modelled else np.nan,
        impacts=extremes.impacts,
        steps=space.step,
        frames=watch.frames,
    )


class _Watch(Watch):
    """A schedule with a frame after each step that passes a sampling time; it keeps the state before that step."""

    def __init__(self, space: Space, times: FloatArray, guard: RunGuard) -> None:
        self.is_over = False  # whether the run was stopped at its bound
        self.position: list[FloatArray] = []
        self.velocity: list[FloatArray] = []
        self.met: dict[int, float] = {}  # s, time of the first contact of each pair, by i (n + p) + j
        self._space, self._times, self._guard = space, times, guard
        interval = auto.frame_interval(space.scene)
        self._recorded = every(interval) if interval else None  # None: every step
        self._frames, self._last_recorded = 1, True  # the initial frame
        self._ends = len(space.state) + len(space.planes)
        self._overlaps: list[FloatArray] = []  # overlaps relative to the smaller radius, late in the run
        self._touching = np.empty(0, dtype=np.int64)  # the contacts of the previous step
        self._touched: set[int] = set()  # pairs that touch at the start, which have no first contact
        self._start = self._began = space.time  # s, start of the run, and of the previous step
        self._before: tuple[float, FloatArray, FloatArray, FloatArray]

    def quiet(self, step: int, time: float) -> tuple[float, float]:
        """Return for how many steps and until when (s) no sample or frame is due; store the last step's contacts."""
        if not self._space.has_solution:
            self.see_contacts(time)
        steps, until = quiet(self._recorded, step, time) if self._recorded else (math.inf, math.inf)
        due = float(self._times[len(self.position)]) if len(self.position) < len(self._times) else math.inf
        return min(steps, max(1.0, self._guard.most - step)), min(until, due)

    def __call__(self, step: int, before: float, time: float) -> bool:
        """Copy the state before a step; an integrator that knows the states within a step calls this after it."""
        if self._space.has_solution:
            self._began = before
            self.see_contacts(time)
        else:
            self.see_contacts(before)
            self._began = before
        if self._recorded:
            self._last_recorded = self._recorded(step, before, time)
            self._frames += self._last_recorded
        else:
            self._frames = step + 1
        done = len(self.position)
        passes = done < len(self._times) and time >= self._times[done]
        if time < self._times[-1] and self._guard.is_over(step, time):
            self.is_over = True
            self._space.stop()
        if passes:
            state = self._space.state
            self._before = (before, state.position.copy(), state.velocity.copy(), state.acceleration.copy())
        return passes

    def see_contacts(self, time: float) -> None:
        """Store the pairs that touch for the first time in the step that ended at a time in s."""
        graph = self._space.contacts
        touching = graph.pairs[:, 0] * self._ends + graph.pairs[:, 1]
        if not np.array_equal(touching, self._touching):
            met = np.full(len(graph), time) if graph.into_step is None else self._began + graph.into_step
            fresh = ~np.isin(touching, self._touching, assume_unique=True)
            order = np.argsort(met[fresh], kind="stable")
            for pair, moment in zip(touching[fresh][order].tolist(), met[fresh][order].tolist(), strict=True):
                if moment == time and self._began == self._start:  # no impact in the first step: it touched before
                    self._touched.add(pair)
                elif pair not in self._touched:
                    self.met.setdefault(pair, moment)
            self._touching = touching

    @property
    def frames(self) -> int:
        """The number of frames in a recording of the run so far; the end of the run is always a frame."""
        return self._frames + (not self._last_recorded)

    @property
    def sinking(self) -> float:
        """Mean overlap, relative to the smaller radius, of contacts late in the run; 0 without such contacts."""
        overlaps = np.concatenate(self._overlaps) if self._overlaps else np.empty(0)
        return float(overlaps.mean()) if len(overlaps) else 0.0

    def sample(self, frame: Frame) -> None:
        """Store the samples within the step of a frame."""
        graph = frame.contacts
        if len(self.position) >= LATE * len(self._times):
            self._overlaps.append(graph.overlaps / self._space.state.ends.radius[graph.pairs].min(axis=1))
        if self._space.has_solution:
            # the samples come from the integrator's own solution within its last step
            while len(self.position) < len(self._times) and self._times[len(self.position)] <= frame.time:
                solution = self._space.between(float(self._times[len(self.position)]))
                assert solution is not None
                self.position.append(solution[0])
                self.velocity.append(solution[1])
            return
        begin, x, v, a = self._before
        dt = frame.time - begin
        impacts = self._space.impacts
        touching, struck = np.zeros((2, self._ends, 1), dtype=np.bool_)
        touching[graph.pairs] = True
        struck[impacts.pairs] = True
        flight = _Flight(v, a, (frame.acceleration - a) / dt, self._space.scene)
        way = frame.position - x
        if self._space.box is not None:
            way = minimum_images(way, self._space.box)
        way_end, v_end = flight.at(dt)  # at the end of the step if there were no impacts
        missing, ahead = way - way_end, frame.velocity - v_end
        # an impact at the end of the step changes the final velocity; otherwise differences are rounding
        gained = 2.0 / dt * missing
        gained = np.where(np.abs(gained - ahead) <= ROUNDINGS * np.spacing(np.abs(x)) / dt, ahead, gained)
        none = np.zeros_like(v)
        forces = (none, flight.behind(dt, ahead)) if self._space.ends_with_forces else None
        flown = 0  # number of impacts so far
        while len(self.position) < len(self._times) and self._times[len(self.position)] <= frame.time:
            h = self._times[len(self.position)] - begin
            while flown < len(impacts) and impacts.time[flown] < h:
                flight.bend(impacts.pairs[flown], float(impacts.time[flown]), impacts.after[flown])
                flown += 1
            s = h / dt
            held = s * s * missing, s * gained
            smooth = between(s, dt, missing, none, ahead, forces)
            moved, velocity = (
                free + np.where(struck[: len(v)], 0.0, np.where(touching[: len(v)], by_contacts, by_forces))
                for free, by_contacts, by_forces in zip(flight.at(h), held, smooth, strict=True)
            )
            if h == dt:
                moved, velocity = way, frame.velocity
            self.position.append(x + moved)
            self.velocity.append(velocity)


class _Flight:
    """The paths of all bodies from the beginning of a step, with their impacts.

    Accelerations without drag change linearly; drag, -v/τ, has a closed form.
    """

    def __init__(self, v: FloatArray, a: FloatArray, jerk: FloatArray, scene: Scene) -> None:
        self._way, self._v, self._a, self._jerk = np.zeros_like(v), v.copy(), a, jerk
        self._since = np.zeros((len(v), 1))  # s, time of each body's last impact
        self._drag = scene.drag

    def at(self, h: float | FloatArray, bodies: slice | IntArray = slice(None)) -> tuple[FloatArray, FloatArray]:
        """Return displacements and velocities a time h (s) after the start."""
        since, v, jerk = self._since[bodies], self._v[bodies], self._jerk[bodies]
        s, a = h - since, self._a[bodies] + since * jerk
        if self._drag is None:
            return self._way[bodies] + s * v + s * s / 2 * a + s**3 / 6 * jerk, v + s * a + s * s / 2 * jerk
        tau = self._drag.relaxation_time
        final = tau * a  # m/s
        lost = -np.expm1(-s / tau)  # lost fraction of the velocity relative to its final value
        moved = s * final + tau * lost * (v - final) + s**3 / 6 * jerk
        return self._way[bodies] + moved, v + lost * (final - v) + s * s / 2 * jerk

    def behind(self, h: float, ahead: FloatArray) -> FloatArray:
        """Return the missing acceleration a time h (s) after the start: the drag on the missing velocities."""
        if self._drag is None:
            return np.zeros_like(ahead)
        return np.asarray(-(ahead + h * h / 2 * self._jerk) / self._drag.relaxation_time)

    def bend(self, pair: IntArray, moment: float, after: FloatArray) -> None:
        """Add an impact at a time in s, with the velocities of the pair right after it."""
        moving = pair < len(self._way)  # planes do not move
        bodies = pair[moving]
        self._way[bodies], _ = self.at(moment, bodies)
        self._v[bodies], self._since[bodies] = after[moving], moment


def between(
    s: float, dt: float, way: FloatArray, v0: FloatArray, v1: FloatArray, forces: tuple[FloatArray, FloatArray] | None
) -> tuple[FloatArray, FloatArray]:
    """Return displacement and velocity at s in [0, 1] of the Hermite polynomial of degree five or three."""
    u0, u1 = v0 * dt, v1 * dt
    c5, c4, c3, c2 = np.zeros_like(way), np.zeros_like(way), u0 + u1 - 2 * way, 3 * way - 2 * u0 - u1
    if forces is not None:
        b0, b1 = (a * dt * dt / 2 for a in forces)
        c2 = b0
        c3 = 10 * way - 6 * u0 - 4 * u1 - 3 * b0 + b1
        c4 = -15 * way + 8 * u0 + 7 * u1 + 3 * b0 - 2 * b1
        c5 = 6 * way - 3 * u0 - 3 * u1 - b0 + b1
    moved = s * (u0 + s * (c2 + s * (c3 + s * (c4 + s * c5))))
    velocity = (u0 + s * (2 * c2 + s * (3 * c3 + s * (4 * c4 + s * 5 * c5)))) / dt
    return moved, velocity


def write_document(path: Path, document: dict[str, Any]) -> None:
    """Write the document from which an interrupted study continues."""
    write_whole(path, json.dumps(document, indent=1, ensure_ascii=False))
