"""Estimates the cost of a run, by part and entity, from a few steps and frames and a coarse run."""

from __future__ import annotations

import math
import statistics
import sys
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from carom.errors import PhysicsError
from carom.physics.diagnostics.run_monitor import Profile, remedies_of
from carom.physics.forces.gravity import gravity_of
from carom.physics.forces.gravity.direct import MAX_IN_ONE_BLOCK
from carom.physics.jit.decorators import Compilations
from carom.physics.jit.team import Team
from carom.physics.look_ahead.trial_run import CALL_WITH_CONTACTS, Watcher
from carom.physics.placement import place
from carom.physics.schedule import at, every
from carom.physics.space import Space
from carom.physics.step import WARM_UP_STEPS
from carom.plan.auto import (
    auto_interval,
    cfl,
    frame_interval,
    integrator,
    most_steps,
    smallest_radius,
    step_limits,
)
from carom.plan.features import Requirements
from carom.plan.room import memory_estimate
from carom.private_folder import temporary_folder
from carom.recording.schema.header import Header, TimeScale
from carom.recording.schema.series import contents
from carom.recording.write.encoder import BatchEncoder
from carom.recording.write.impact_plan import FILE_BYTES
from carom.recording.write.recorder import CheckpointPlan
from carom.recording.write.static_entities import statics
from carom.recording.write.stream import BATCH_BYTES, Stream, frames_in_batch
from carom.runs.run import header_of, kept_accuracy, recording_space, shortfall_text
from carom.scene.forces import FORCES
from carom.scene.load import Scene
from carom.scene.start import InitialBodies
from carom.scene.units.dimension import LENGTH, TIME
from carom.state.frame import Frame

TRIAL_SECONDS = 0.1
TRIAL_STEPS = 200
LOADING_STEPS = 3
PULL_SECONDS, PULL_ROUNDS = 0.05, 15  # for the measurement of the cost of the potential
FLIGHT_STEPS, FLIGHT_ROUNDS, FLIGHT_SECONDS = 500, 10, 0.2  # for the measurement of steps that one call makes in bulk
KEPT_FRAMES, KEPT_BYTES = 8, 100_000_000
FRAME_BYTES = 250  # per body in a frame

# The part of the model for each mark in a step's profile; the second one applies if the scene lacks the first.
MARKS = {
    "timestep": ("adaptive-step", "integrator"),
    "orientation": ("orientation", "integrator"),
    "integrate": ("integrator", "integrator"),
    "impacts": ("time-of-impact", "integrator"),
    "search": ("broad-phase", "contact"),
    "colouring": ("colouring", "contact"),
    "stabilisation": ("stabilisation", "contact"),
    **{kind.short_name: (kind.name, "integrator") for kind in FORCES},
    "resting": ("resting-contacts", "contact"),
    "sleep": ("resting-contacts", "contact"),
    "response": ("contact", "integrator"),
    "torque": ("torque", "contact"),
    "ledger": ("energy", "energy"),
    "energy": ("energy", "energy"),
}


@dataclass(frozen=True, slots=True)
class PartCost:
    """A part of the model, and its cost."""

    name: str
    modelled: bool
    why: str
    share: float | None  # fraction of the time of a run; None if it is not modelled or not measured separately
    within: str | None  # the part whose time includes this one


@dataclass(frozen=True, slots=True)
class EntityCost:
    """An entity of the recording, and its size."""

    path: str
    recorded: bool
    why: str
    share: float | None  # fraction of the bytes of a recording; None if it is not recorded
    bytes: float  # of the whole recording
    seconds: float  # of the whole run, in the recorder's thread


@dataclass(frozen=True, slots=True)
class Cost:
    """Estimated cost of a run."""

    steps: int
    fewest_steps: int  # lower end of the estimated range
    most_steps: int
    limits: dict[str, float]  # fraction of the steps set by each limit, the largest first
    looked_until: float  # s, the end of the coarse run: the end of the run, unless the coarse run took too long
    seconds: float
    memory: int  # bytes, without the interpreter
    frames: int
    frame_seconds: float  # time to record a frame, in a separate thread
    size: int  # bytes of the recording


@dataclass(frozen=True, slots=True)
class Estimate:
    """Parts, entities and cost of a run."""

    parts: list[PartCost]
    entities: list[EntityCost]
    cost: Cost
    accuracy: dict[str, float]  # see `kept_accuracy`
    shortfall: str  # why the accuracy is not kept to the end; empty if it is
    slow: str  # when and why steps become so short that the run takes long; empty if it does not


def estimate(scene: Scene, watch_look_ahead: Watcher | None = None) -> Estimate:
    """Time the first steps of a scene for about a tenth of a second, run the scene coarsely, and record a few frames.

    For ``watch_look_ahead`` see `Space`. Raises SceneError or PhysicsError if the scene cannot run.
    """
    bodies = place(scene)
    space = recording_space(scene, None, watch_look_ahead, bodies)
    # a few steps first, so that the compilation and loading of kernels are not measured
    start = space.frame().checkpoint
    for step in range(1, LOADING_STEPS + 1):
        if space.time < space.scene.time.duration:
            space.compute_dynamics(step)
    space.restore(start)
    space.profile.clear()
    start, compiled = space.frame().checkpoint, 1
    while compiled:  # repeat without compilations, such as of the kernels of the first impact
        space.restore(start)
        space.profile.clear()
        with Compilations() as compilations:
            began = time.perf_counter()
            few = _first_frames(space)
            spent = time.perf_counter() - began
        compiled = compilations.count
    scene = space.scene  # with the step chosen for its accuracy
    flight = flight_seconds(space, bodies)
    each = spent / space.step if space.requirements.contact.modelled else min(flight, spent / space.step)
    outlook = estimate_steps(scene, each, flight, bodies)
    steps, frames = outlook.steps, outlook.frames
    header = header_of(space)
    with temporary_folder() as folder:
        taken = probe(folder / "trial.rrd", header, outlook.samples or few)
    costs = []  # bytes and seconds of each entity
    for content in contents(header, space.requirements):
        entity = taken.get(content.path, Taken(0, 0.0, 0.0))
        costs.append((content, entity.once + entity.bytes * frames, entity.seconds * frames))
    size = sum(bytes_ for _, bytes_, _ in costs)
    return Estimate(
        parts=_part_costs(space, steps, frames),
        entities=[
            EntityCost(*content, bytes_ / size if content.recorded else None, bytes_, seconds)
            for content, bytes_, seconds in costs
        ],
        cost=Cost(
            steps=steps,
            fewest_steps=outlook.fewest,
            most_steps=outlook.most,
            limits=outlook.limits,
            looked_until=outlook.seen * scene.time.duration,
            seconds=outlook.seconds,
            memory=memory_estimate(scene),
            frames=frames,
            frame_seconds=sum(each.seconds for each in taken.values()),
            size=FILE_BYTES + round(size),
        ),
        accuracy=kept_accuracy(space.scene),
        shortfall=shortfall_text(space.scene),
        slow=slow_text(scene, outlook),
    )


def _first_frames(space: Space) -> list[Frame]:
    """Run the first steps; return their last few frames."""
    deadline, room = time.perf_counter() + TRIAL_SECONDS, _frames_to_keep(space)
    wanted = every(frame_interval(space.scene))

    def over() -> bool:
        return space.step >= TRIAL_STEPS or time.perf_counter() > deadline

    frames: list[Frame] = []
    for frame in space.run(schedule=lambda step, before, now: wanted(step, before, now) or over()):
        frames = [*frames, frame][-room:]
        if space.step > 0 and over():
            break
    return frames


def _frames_to_keep(space: Space) -> int:
    return max(1, min(KEPT_FRAMES, KEPT_BYTES // (FRAME_BYTES * len(space.state))))


def flight_seconds(space: Space, start: InitialBodies | None = None) -> float:
    """Return the time of a step without contacts, including its part of a check and a frame.

    A run makes many of these steps in one call. The time is infinite for many bodies, since each of their steps is a
    separate call.
    """
    if len(space.state) > MAX_IN_ONE_BLOCK:
        return math.inf
    apart = max(
        1, min(FLIGHT_STEPS, round(frame_interval(space.scene) / (space.dt or space.first_dt)))
    )  # steps from frame to frame
    flying, paces, began = Space(space.scene, start=start), list[float](), math.inf
    step, touched = 0, 0
    for _ in flying.run(schedule=at(range(apart, apart * FLIGHT_ROUNDS + 1, apart))):
        now = time.perf_counter()
        if flying.step > step and flying.extremes.total_contacts == touched:
            paces.append((now - began) / (flying.step - step))
        if flying.step >= apart * FLIGHT_ROUNDS or now - began > FLIGHT_SECONDS:
            break
        step, touched, began = flying.step, flying.extremes.total_contacts, now
    return statistics.median(paces) if paces else math.inf


def _part_costs(space: Space, steps: int, frames: int) -> list[PartCost]:
    """Divide the time of a run among the parts."""
    needs = space.requirements
    modelled = {part.name for part in needs.parts if part.modelled}
    seconds = dict.fromkeys(modelled, 0.0)  # a step
    for mark, spent in space.profile.seconds().items():
        name, otherwise = MARKS.get(mark, (mark, "integrator"))  # a force of an installed package is marked by its name
        seconds[name if name in modelled else otherwise] += spent / space.step
    if needs.potential.modelled:
        more, duration = _more_for_the_potential(space), space.scene.time.duration
        by_time = max(frames, duration / auto_interval(space.scene, duration))  # most frames are checks
        seconds["potential"] = more * min(1.0, 1.0 / space.scene.record.check_every + by_time / steps)
        seconds["gravity"] = max(0.0, seconds["gravity"] - seconds["potential"])
    if needs.warm_up.modelled:
        seconds["warm-up"] = sum(seconds.values()) * WARM_UP_STEPS / steps
    whole = sum(seconds.values())
    costs = []
    for part in needs.parts:
        within = _within(part.name, needs) if part.modelled else None
        share = None
        if part.modelled and not within:
            share = seconds[part.name] / whole if whole else 0.0
        costs.append(PartCost(part.name, part.modelled, part.why, share, within))
    return costs


def _more_for_the_potential(space: Space) -> float:
    """Return the additional time (s) of gravity with the potential, from medians of interleaved calls."""
    gravity = gravity_of(space.scene, space.state.mass, Team(space.threads))
    if gravity is None:
        return 0.0
    acceleration = np.empty_like(space.state.acceleration)
    spent: dict[bool, list[float]] = {False: [], True: []}
    deadline = time.perf_counter() + PULL_SECONDS
    for _ in range(PULL_ROUNDS):
        for potential, times in spent.items():
            began = time.perf_counter()
            gravity.accelerate(space.state.position, acceleration, potential)
            times.append(time.perf_counter() - began)
        if time.perf_counter() > deadline:
            break
    return max(0.0, statistics.median(spent[True]) - statistics.median(spent[False]))


def _within(name: str, needs: Requirements) -> str | None:
    """Return the part that is computed together with this one, so that their times cannot be separated."""
    spin = "contact" if needs.friction.modelled else "energy"
    with_others = {"narrow-phase": "broad-phase", "tree": "gravity", "spin": spin}
    return (with_others | {"restitution": "contact", "friction": "contact"}).get(name)


STRIDES = 8.0, 64.0  # coarse steps over the steps of the scene; the second if the first would take too long
LOOK_SECONDS = 3.0  # for each coarse run
GLANCE_SECONDS = 0.1  # for a coarse run that would cover less than this fraction of the duration in its time
LEAST_SEEN = 0.05
SHORTER = 10.0  # factor by which steps shorten in a run that becomes slow
LONG_RUN = 600.0  # s; a run that takes longer is announced
WORTH_A_LOOK = 1e7  # conceivable steps, some 10 s of the fastest ones; with fewer, no trial is made before a run
FORWARN_SECONDS = 1.0  # for each coarse run before a run
MANY_STEPS = 100  # coarse steps; with more, their mean time is more accurate than the first steps' mean
LIKELY = 2.0  # accuracy (a factor) of a complete estimate for the bundled scenes and extremes (test_estimate.py)


@dataclass(frozen=True, slots=True)
class Outlook:
    """Estimated steps of a whole run."""

    steps: int
    fewest: int
    most: int
    seconds: float
    seen: float  # fraction of the duration covered by the coarse run; 1 if it reached the end
    limits: dict[str, float]  # fraction of the steps set by each limit, the largest first
    frames: int  # of the recording
    samples: list[Frame]  # from all of the coarse run, as a recording would have them; empty if it was too short
    short_from: float | None  # s, from which steps are `SHORTER` than some before; None if there is no such time
    short_step: float  # s, the mean at the end of the coarse run
    short_limit: str  # the limit that sets these steps


def estimate_steps(
    scene: Scene,
    step_seconds: float,
    flight_seconds: float = math.inf,
    start: InitialBodies | None = None,
    look_seconds: float = LOOK_SECONDS,
) -> Outlook:
    """Estimate the steps of a run, given that each of its first steps takes ``step_seconds``.

    ``flight_seconds`` is the time of a step without contacts, if a run, unlike the coarse run, makes many of these in
    one call; ``start`` are the initial bodies, if known. A coarse run takes ``look_seconds`` at most. Raises
    SceneError or PhysicsError if the scene cannot run.
    """
    fixed = scene.time.fixed_dt
    if fixed is not None:
        found = _look(scene, 1.0, step_seconds, flight_seconds, start, look_seconds)
        steps = max(1, round(scene.time.duration / fixed))
        return replace(found, steps=steps, fewest=steps, most=steps, seen=1.0, limits={"fixed": 1.0})
    best: Outlook | None = None
    for stride in STRIDES:
        if best is None or LEAST_SEEN * STRIDES[0] / stride < best.seen < 1.0:
            found = _look(scene, stride, step_seconds, flight_seconds, start, look_seconds)
            best = found if best is None or found.seen > best.seen else best
    assert best is not None
    return best


def forewarning(space: Space) -> str:
    """Return what is to be said of a run before it starts if it will take long; otherwise an empty text.

    Only a scene that conceivably takes many steps is run coarsely, for a second or two.
    """
    scene = space.scene
    if most_steps(scene, space.first_dt) < WORTH_A_LOOK:
        return ""
    flight = flight_seconds(space)
    each = flight if math.isfinite(flight) else CALL_WITH_CONTACTS
    return slow_text(scene, estimate_steps(scene, each, flight, look_seconds=FORWARN_SECONDS))


def slow_text(scene: Scene, outlook: Outlook) -> str:
    """Return when and why the steps of a run become short, and the remedy; empty unless the run takes long."""
    if outlook.seconds < LONG_RUN:
        return ""
    units, limit = scene.unit_system, outlook.short_limit
    text = f"this run takes about {outlook.steps:.2g} steps, {outlook.seconds / 3600.0:.2g} hours: "
    if outlook.short_from is not None:
        text += f"from t = {units.text(outlook.short_from, TIME, '.4g')} on, "
    text += f"steps are as short as {units.text(outlook.short_step, TIME, '.2g')} (limit: {limit}); "
    if limit == "velocity":
        smallest = units.text(smallest_radius(scene), LENGTH, ".3g")
        text += f"a body moves by at most time.cfl = {cfl(scene):g} of its radius, {smallest} for the smallest; "
    remedy = remedies_of(scene).get(limit)
    shorten = "shorten time.duration" if outlook.short_from is None else "end time.duration there"
    return f"{text}{f'raise {remedy}, or ' if remedy else ''}{shorten}"


def _look(
    scene: Scene,
    stride: float,
    step_seconds: float,
    flight_seconds: float,
    start: InitialBodies | None,
    look_seconds: float,
) -> Outlook:
    """Run the whole scene with longer steps, count the steps of an actual run, and keep some frames."""
    space, duration, fixed = recording_space(scene, None, None, start, stride), scene.time.duration, scene.time.fixed_dt
    samples, room, interval, since = list[Frame](), _frames_to_keep(space), frame_interval(scene), math.inf
    began = last = time.perf_counter()
    rates: list[float] = []  # 1/s, steps of the scene in a second of its time
    times, named = list[float](), list[str]()  # s, from which each applies; the limit that sets these steps
    known: dict[str, float] = {}  # steps so far, by limit
    before, total, counted, frames, seconds, touched = 0.0, 0.0, 0.0, 0.0, 0.0, 0
    while before < duration and last - began < look_seconds:
        if last - began > GLANCE_SECONDS and before < LEAST_SEEN * duration * (last - began) / look_seconds:
            break  # a longer run would hardly cover more
        try:
            space.compute_dynamics(space.step + 1)
            now = time.perf_counter()
            if since < math.inf and space.time - since >= interval:
                samples.append(_with_impacts_of(interval, space.time - since, space.frame()))
                since = math.inf
            elif since == math.inf and space.time >= (len(samples) + 0.5) * duration / room:
                space.frame()  # the next frame then has the impacts from here on
                since = space.time
        except PhysicsError:
            if not rates:
                raise
            break  # the step is too long for this scene: use the results so far
        foreseen = sum(space.foreseen.values())
        rates.append((foreseen - total) / space.dt if fixed is None else 1.0 / fixed)
        times.append(before)
        named.append(
            max(space.foreseen, key=lambda limit: space.foreseen[limit] - known.get(limit, 0.0), default="fixed")
        )
        known = dict(space.foreseen)
        span = min(space.time, duration) - before
        within = rates[-1] * span
        frames += min(within, span / interval) if interval > 0.0 else within
        contacts = space.extremes.total_contacts
        each = now - last if contacts > touched else min(now - last, flight_seconds)
        counted, seconds = counted + within, seconds + each * within
        last, total, before, touched = time.perf_counter(), foreseen, space.time, contacts
    rest = max(0.0, duration - before)
    half, lately = rates[len(rates) // 2 :], rates[-max(1, len(rates) // 4) :]
    latest = sum(lately) / len(lately)
    steps, k = counted + rest * latest, len(rates)
    while k > 0 and SHORTER * rates[k - 1] >= latest:
        k -= 1
    fewest, most = (counted + rest * min(half)) / LIKELY, (counted + rest * max(half)) * LIKELY
    if not integrator(scene).controls_error and scene.promise is None:
        fewest = max(fewest, min(steps, duration / step_limits(scene).max_dt))
    shares = {limit: count / total for limit, count in space.foreseen.items()}
    return Outlook(
        steps=_whole(steps),
        fewest=_whole(fewest),
        most=_whole(most),
        seconds=steps * (seconds / counted if counted > MANY_STEPS else step_seconds),
        seen=1.0 - rest / duration,
        limits=dict(sorted(shares.items(), key=lambda item: -item[1])),
        frames=1 + _whole(frames * duration / (duration - rest)),
        samples=samples,
        short_from=times[k] if 0 < k < len(times) else None,
        short_step=1.0 / latest,
        short_limit=Counter(named[k:] or named).most_common(1)[0][0],
    )


def _with_impacts_of(interval: float, span: float, frame: Frame) -> Frame:
    """Return a frame with the share of its impacts that fall into an interval (s), which a coarse step may exceed."""
    if frame.impacts is None or span <= interval:
        return frame
    return replace(frame, impacts=frame.impacts[: round(len(frame.impacts) * interval / span)])


def _whole(steps: float) -> int:
    return max(1, round(min(steps, sys.float_info.max)))


BATCH_FRAMES = 100  # at most, in the batch that is written to measure sizes


@dataclass(frozen=True, slots=True)
class Taken:
    """The cost of one entity."""

    once: int  # bytes of static data
    bytes: float  # compressed bytes of arrays per frame
    seconds: float  # s of the recorder's thread per frame


def probe(path: Path, header: Header, frames: Sequence[Frame]) -> dict[str, Taken]:
    """Write a batch of repeated frames to a temporary file; return the cost of each entity, in the order of writing."""
    clock = TimeScale()
    origin = np.average(frames[0].position, axis=0, weights=header.mass)
    once = {
        entity: sum(batch.as_arrow_array().nbytes for batch in archetype.as_component_batches())
        for entity, archetype in statics(header, clock, origin, 1.0)
    }
    count = max(1, min(BATCH_FRAMES, frames_in_batch(header.bodies)))
    batch = [replace(frames[k % len(frames)], step=k, time=float(k), slot=None) for k in range(count)]
    stream = Stream(path, header, batch_bytes=BATCH_BYTES, live=None)
    try:
        different = batch[: len(frames)]
        _send(different, stream, BatchEncoder(header, origin), clock)  # loads libraries and kernels: not measured
        raw, compressed = Counter[str](), Counter[str]()
        for rows in BatchEncoder(header, origin).rows(different):
            raw[rows.path] += rows.bytes
            compressed[rows.path] += rows.compressed_bytes
        sizes, profile = _send(batch, stream, BatchEncoder(header, origin), clock)
    finally:
        stream.close()
    seconds = profile.seconds()
    fraction = {entity: compressed[entity] / size for entity, size in raw.items() if size}
    return {
        entity: Taken(
            once.get(entity, 0),
            fraction.get(entity, 1.0) * sizes[entity] / count,
            seconds.get(entity, 0.0) / count,
        )
        for entity in dict.fromkeys([*once, *sizes])
    }


def _send(batch: list[Frame], stream: Stream, encoder: BatchEncoder, clock: TimeScale) -> tuple[Counter[str], Profile]:
    """Send a batch as the recorder does; return the bytes of each entity, and its time."""
    sizes, profile = Counter[str](), Profile()
    profile.start()
    for rows in encoder.rows(batch):
        stream.send(rows, clock)
        sizes[rows.path] += rows.bytes
        profile.mark(rows.path)
    kept = encoder.checkpoints(CheckpointPlan().chosen(batch))
    stream.send(kept, clock)
    sizes[kept.path] += kept.bytes
    profile.mark(kept.path)
    stream.flush()
    return sizes, profile
