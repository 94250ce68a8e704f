"""Estimates the cost of a run, by part and entity, from a few steps and frames and a coarse run."""

from __future__ import annotations

import statistics
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np

from carom.physics.diagnostics.run_monitor import Profile
from carom.physics.forces.gravity import gravity_of
from carom.physics.jit.kernel_watch import KernelWatch
from carom.physics.jit.team import Team
from carom.physics.look_ahead.trial_run import Watcher
from carom.physics.placement import place
from carom.physics.schedule import every
from carom.physics.space import Space
from carom.physics.step import WARM_UP_STEPS
from carom.plan.auto import auto_interval, frame_interval
from carom.plan.features import Requirements, own_kernels
from carom.plan.room import TRIALS, memory_estimate, refuse_small_memory, resident_memory
from carom.private_folder import temporary_folder
from carom.recording.schema.header import Header, TimeScale
from carom.recording.schema.series import contents
from carom.recording.write.encoder import BatchEncoder
from carom.recording.write.impact_plan import FILE_BYTES
from carom.recording.write.recorder import CheckpointPlan, waiting_frames
from carom.recording.write.static_entities import statics
from carom.recording.write.stream import BATCH_BYTES, Stream, frames_in_batch
from carom.runs.outlook import estimate_steps, flight_seconds, frames_to_keep, slow_text
from carom.runs.run import header_of, kept_accuracy, recording_space, shortfall_text
from carom.runs.stopwatch import TrialClock
from carom.scene.explanation import naming_places
from carom.scene.forces import FORCES
from carom.scene.load import Scene
from carom.state.frame import Frame

TRIAL_SECONDS = 0.1
TRIAL_STEPS = 200
LOADING_STEPS = 3
PULL_SECONDS, PULL_ROUNDS = 0.05, 15  # s and rounds for measuring the cost of the potential
# s of CPU time, measured on two cores of a shared AMD EPYC
LIBRARIES = 2.0  # s, longest time for the imports of a command; on an idle machine, they take 1.0 s
LOADING = 0.005  # s to load a kernel that had to be compiled here
CLOSING = 0.3  # s to open the file, write the layout, close the file and count its frames
# bytes, measured in runs of 1 to 1000 bodies
LIBRARY_BYTES = 310_000_000  # Python, libraries and kernels
RECORDER_BYTES = 40_000_000  # Rerun's encoder, a batch of columns, the check of the closed file

# The part of the model for each mark in a step's profile. If a scene lacks the first part, the second is used.
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
    "release": ("release", "contact"),
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
    share: float | None  # fraction of a run's time; None if it is not modelled or not measured separately
    within: str | None  # the part whose time includes the time of this part


@dataclass(frozen=True, slots=True)
class EntityCost:
    """An entity of the recording, and its size."""

    path: str
    recorded: bool
    why: str
    share: float | None  # fraction of a recording's bytes; None if the entity is not recorded
    bytes: float  # bytes of this entity in the whole recording
    seconds: float  # s of the recorder's thread for this entity in the whole run


@dataclass(frozen=True, slots=True)
class Cost:
    """Estimated cost of a run."""

    steps: int
    fewest_steps: int  # smallest number of steps in the estimated range
    most_steps: int
    limits: dict[str, float]  # fraction of the steps that each limit sets; the largest fraction first
    looked_until: float  # s, end of the coarse run, which is the end of the run unless the coarse run took too long
    seconds: float  # s to compute everything: start, all steps and all frames
    start_seconds: float  # s to load libraries and kernels, to find the step of an accuracy, and to close the file
    step_seconds: float  # s for a step, averaged over all steps
    frame_seconds: float  # s to copy and record a frame
    compile_seconds: float  # s for compiling the kernels that this estimate compiled; a run now finds them in the cache
    compiled: int  # number of these kernels
    own_kernels: list[str]  # parts of the scene with kernels of their own, which every new machine compiles first
    memory: int  # bytes of the process, including libraries and kernels
    frames: int
    size: int  # bytes of the recording


@dataclass(frozen=True, slots=True)
class Estimate:
    """Parts, entities and cost of a run."""

    parts: list[PartCost]
    entities: list[EntityCost]
    cost: Cost
    accuracy: dict[str, float]  # see `kept_accuracy`
    shortfall: str  # why the accuracy is not kept to the end; empty if it is
    slow: str  # when and why steps become so short that the run takes long; empty if they do not


def estimate(scene: Scene, watch_look_ahead: Watcher | None = None) -> Estimate:
    """Time the first steps of a scene for about a tenth of a second, run the scene coarsely, and record a few frames.

    For ``watch_look_ahead`` see `Space`. Raises SceneError or PhysicsError if the scene cannot run.
    """
    with naming_places(scene):
        refuse_small_memory(scene, TRIALS)
    libraries = min(time.process_time(), LIBRARIES)
    with TrialClock() as clock:
        bodies = place(scene)
        space = recording_space(scene, None, watch_look_ahead, bodies)
        few, building, each = _measured_steps(space, clock)
        scene = space.scene  # the scene with the step chosen for its accuracy
        flight = flight_seconds(space, bodies)
        if not space.requirements.contact.modelled:
            each = min(flight, each)
        outlook = estimate_steps(scene, each, flight, bodies)
        steps, frames = outlook.steps, outlook.frames
        header = header_of(space)
        with temporary_folder() as folder:
            taken = probe(folder / "trial.rrd", header, outlook.samples or few)
        kernels = clock.kernels
    costs = []  # costs of the entities
    for content in contents(header, space.requirements):
        entity = taken.get(content.path, Taken(0, 0.0, 0.0))
        costs.append((content, entity.once + entity.bytes * frames, entity.seconds * frames))
    size = sum(bytes_ for _, bytes_, _ in costs)
    start_seconds = libraries + building + kernels.loading + LOADING * kernels.compiled + CLOSING
    frame_seconds = outlook.frame_seconds + sum(each.seconds for each in taken.values())
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
            seconds=start_seconds + outlook.seconds + frames * frame_seconds,
            start_seconds=start_seconds,
            step_seconds=outlook.seconds,
            frame_seconds=frame_seconds,
            compile_seconds=kernels.compiling,
            compiled=kernels.compiled,
            own_kernels=own_kernels(scene),
            memory=_memory(scene, outlook.samples or few, frames, compiled=kernels.compiled > 0),
            frames=frames,
            size=FILE_BYTES + round(size),
        ),
        accuracy=kept_accuracy(space.scene),
        shortfall=shortfall_text(space.scene),
        slow=slow_text(scene, outlook),
    )


def _memory(scene: Scene, samples: list[Frame], frames: int, *, compiled: bool) -> int:
    """Return the memory of a run in bytes: for the process itself, and for the frames that wait to be written."""
    # a compilation leaves memory that a run does not need
    process = LIBRARY_BYTES + memory_estimate(scene) if compiled else resident_memory()
    waiting = min(frames, waiting_frames(scene.count)[2])
    return process + RECORDER_BYTES + waiting * sum(map(_bytes_of, samples)) // len(samples)


def _bytes_of(frame: Frame) -> int:
    arrays = [getattr(frame, each.name) for each in fields(frame)]
    contacts = [getattr(frame.contacts, name) for name in ("pairs", "normals", "overlaps", "colours")]
    return sum(array.nbytes for array in arrays + contacts if isinstance(array, np.ndarray))


def _measured_steps(space: Space, clock: TrialClock) -> tuple[list[Frame], float, float]:
    """Run the first steps; return their last frames, the seconds so far without kernels, and the seconds of a step."""
    # a few steps come first, so that the loading of kernels in the first step is not measured
    start = space.frame().checkpoint
    for step in range(1, LOADING_STEPS + 1):
        if space.time < space.scene.time.duration:
            space.compute_dynamics(step)
    space.restore(start)
    start, building = space.frame().checkpoint, clock.seconds
    while True:
        space.restore(start)
        space.profile.clear()
        began, kernels = clock.seconds, clock.kernels.seconds
        few = _first_frames(space, clock)
        if clock.kernels.seconds == kernels:
            return few, building, (clock.seconds - began) / space.step
        # the steps are repeated, since the profile included the loading of kernels, for instance at the first impact


def _first_frames(space: Space, clock: TrialClock) -> list[Frame]:
    """Run the first steps; return their last few frames."""
    deadline, room = clock.seconds + TRIAL_SECONDS, frames_to_keep(space)
    wanted = every(frame_interval(space.scene))

    def over() -> bool:
        return space.step >= TRIAL_STEPS or clock.seconds > deadline

    frames: list[Frame] = []
    for frame in space.run(schedule=lambda step, before, now: wanted(step, before, now) or over()):
        frames = [*frames, frame][-room:]
        if space.step > 0 and over():
            break
    return frames


def _part_costs(space: Space, steps: int, frames: int) -> list[PartCost]:
    """Divide the time of a run among the parts."""
    needs = space.requirements
    modelled = {part.name for part in needs.parts if part.modelled}
    seconds = dict.fromkeys(modelled, 0.0)  # seconds in a step, by part
    for mark, spent in space.profile.seconds().items():
        name, otherwise = MARKS.get(mark, (mark, "integrator"))  # a force of an installed package is marked by its name
        seconds[name if name in modelled else otherwise] += spent / space.step
    if needs.potential.modelled:
        more, duration = _more_for_the_potential(space), space.scene.time.duration
        # number of checks at fixed times; most frames are checks, too
        by_time = max(frames, duration / auto_interval(space.scene, duration))
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
    """Return the additional time (s) that gravity takes with the potential, from medians of interleaved calls."""
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
    """Return the part that is computed together with this part, if their times cannot be separated."""
    spin = "contact" if needs.friction.modelled else "energy"
    with_others = {"narrow-phase": "broad-phase", "tree": "gravity", "spin": spin}
    return (with_others | {"restitution": "contact", "friction": "contact"}).get(name)


BATCH_FRAMES = 100  # largest number of frames in the batch that is written to measure sizes


@dataclass(frozen=True, slots=True)
class Taken:
    """The cost of one entity."""

    once: int  # bytes of static data
    bytes: float  # compressed bytes of arrays per frame
    seconds: float  # s per frame in the recorder's thread


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
        # loads libraries and kernels before anything is measured
        _send(different, stream, BatchEncoder(header, origin), clock)
        raw, compressed = Counter[str](), Counter[str]()
        for rows in BatchEncoder(header, origin).rows(different):
            raw[rows.path] += rows.bytes
            compressed[rows.path] += rows.compressed_bytes
        began = time.process_time()  # the time of all threads, since Rerun has its own
        with KernelWatch(time.process_time) as kernels:
            sizes, profile = _send(batch, stream, BatchEncoder(header, origin), clock)
        computing = time.process_time() - began - kernels.seconds
    finally:
        stream.close()
    wall = profile.seconds()
    whole = sum(wall.values())
    seconds = {entity: spent / whole * computing for entity, spent in wall.items()}
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
