"""Estimates the steps of a run by a coarse run: the whole scene with longer steps."""

from __future__ import annotations

import math
import statistics
import sys
from collections import Counter
from dataclasses import dataclass, replace

from carom.errors import PhysicsError
from carom.physics.diagnostics.run_monitor import remedies_of
from carom.physics.forces.gravity.direct import MAX_IN_ONE_BLOCK
from carom.physics.look_ahead.trial_run import CALL_WITH_CONTACTS
from carom.physics.schedule import at
from carom.physics.space import Space
from carom.plan.auto import cfl, frame_interval, integrator, most_steps, smallest_radius, step_limits
from carom.runs.run import recording_space
from carom.runs.stopwatch import TrialClock
from carom.scene.load import Scene
from carom.scene.start import InitialBodies
from carom.scene.units.dimension import LENGTH, TIME
from carom.state.frame import Frame

# for timing steps that one call makes in bulk: steps and rounds, and time limit in s
FLIGHT_STEPS, FLIGHT_ROUNDS, FLIGHT_SECONDS = 500, 10, 0.2
KEPT_FRAMES, KEPT_BYTES = 8, 100_000_000
FRAME_BYTES = 250  # bytes of a body in a frame
# lengths of coarse steps, in steps of the scene; the second is used if the first would take too long
STRIDES = 8.0, 64.0
LOOK_SECONDS = 3.0  # s, time limit of each coarse run
# s after which a coarse run ends early if it would cover less than `LEAST_SEEN` of the duration within its limit
GLANCE_SECONDS = 0.1
LEAST_SEEN = 0.05
SHORTER = 10.0  # factor by which steps must shorten before a run counts as slow
LONG_RUN = 600.0  # s; a run that takes longer is announced
WORTH_A_LOOK = 1e7  # if a run may need this many steps, which take at least 10 s, a coarse run precedes it
FORWARN_SECONDS = 1.0  # s, time limit of each coarse run that precedes a run
MANY_STEPS = 100  # number of coarse steps above which their mean time is more accurate than the time of the first steps
LIKELY = 2.0  # factor within which a complete estimate is right for the bundled scenes and extremes (test_estimate.py)


def frames_to_keep(space: Space) -> int:
    """Return the number of frames that are kept to measure the size of a frame."""
    return max(1, min(KEPT_FRAMES, KEPT_BYTES // (FRAME_BYTES * len(space.state))))


def flight_seconds(space: Space, start: InitialBodies | None = None) -> float:
    """Return the time (s) of a step without contacts, including its share in a check and a frame.

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
    with TrialClock() as clock:
        for _ in flying.run(schedule=at(range(apart, apart * FLIGHT_ROUNDS + 1, apart))):
            now = clock.seconds
            if flying.step > step and flying.extremes.total_contacts == touched:
                paces.append((now - began) / (flying.step - step))
            if flying.step >= apart * FLIGHT_ROUNDS or now > FLIGHT_SECONDS:
                break
            step, touched, began = flying.step, flying.extremes.total_contacts, now
    return statistics.median(paces) if paces else math.inf


@dataclass(frozen=True, slots=True)
class Outlook:
    """Estimated steps of a whole run."""

    steps: int
    fewest: int
    most: int
    seconds: float
    seen: float  # fraction of the duration that the coarse run covered; 1 if it reached the end
    limits: dict[str, float]  # fraction of the steps that each limit sets, the largest first
    frames: int  # number of frames in the recording
    frame_seconds: float  # s for the physics to copy a state, with its energies
    # frames of the coarse run from start to end, as a recording would have them; empty if it was too short
    samples: list[Frame]
    # s, time from which steps are shorter than earlier steps by the factor `SHORTER`; None if there is none
    short_from: float | None
    short_step: float  # s, mean step at the end of the coarse run
    short_limit: str  # the limit that sets the step at the end of the coarse run


def estimate_steps(
    scene: Scene,
    step_seconds: float,
    flight_seconds: float = math.inf,
    start: InitialBodies | None = None,
    look_seconds: float = LOOK_SECONDS,
) -> Outlook:
    """Estimate the steps of a run, given that each of its first steps takes ``step_seconds``.

    ``flight_seconds`` is the time of a step without contacts. It is given if the run, unlike the coarse run, makes many
    such steps in one call. ``start`` are the initial bodies, if known. A coarse run takes ``look_seconds`` at most.
    Raises SceneError or PhysicsError if the scene cannot run.
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
    """Return a warning before a run that will take long; otherwise an empty text.

    A coarse run precedes only scenes that may take many steps, and takes a second or two.
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
    """Run the whole scene with longer steps, estimate the steps that an actual run would take, and keep some frames."""
    space, duration, fixed = recording_space(scene, None, None, start, stride), scene.time.duration, scene.time.fixed_dt
    samples, room, interval, since = list[Frame](), frames_to_keep(space), frame_interval(scene), math.inf
    last = 0.0
    copying: list[float] = []  # s, time of each frame's copy
    rates: list[float] = []  # 1/s, steps of the scene per second of simulated time
    times, named = list[float](), list[str]()  # s, start of each rate, and the limit that sets these steps
    known: dict[str, float] = {}  # numbers of steps so far, by limit
    before, total, counted, frames, seconds, touched = 0.0, 0.0, 0.0, 0.0, 0.0, 0
    with TrialClock() as clock:
        while before < duration and last < look_seconds:
            if last > GLANCE_SECONDS and before < LEAST_SEEN * duration * last / look_seconds:
                break  # a longer look would hardly cover more
            try:
                space.compute_dynamics(space.step + 1)
                now = clock.seconds
                ends = since < math.inf and space.time - since >= interval
                if ends or (since == math.inf and space.time >= (len(samples) + 0.5) * duration / room):
                    frame = space.frame()  # the next frame will have the impacts since this frame
                    copying.append(clock.seconds - now)
                    if ends:
                        samples.append(_with_impacts_of(interval, space.time - since, frame))
                    since = math.inf if ends else space.time
            except PhysicsError:
                if not rates:
                    raise
                break  # the step is too long for this scene: the results so far are used
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
            last, total, before, touched = clock.seconds, foreseen, space.time, contacts
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
        frame_seconds=statistics.median(copying) if copying else 0.0,
        samples=samples,
        short_from=times[k] if 0 < k < len(times) else None,
        short_step=1.0 / latest,
        short_limit=Counter(named[k:] or named).most_common(1)[0][0],
    )


def _with_impacts_of(interval: float, span: float, frame: Frame) -> Frame:
    """Return a frame with as many of its impacts as an interval (s) would have, since a coarse step may be longer."""
    if frame.impacts is None or span <= interval:
        return frame
    return replace(frame, impacts=frame.impacts[: round(len(frame.impacts) * interval / span)])


def _whole(steps: float) -> int:
    return max(1, round(min(steps, sys.float_info.max)))
