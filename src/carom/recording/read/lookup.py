"""Looks up bodies by number or name, moments, and intervals of time in a recording.

By default, the moment of the hardest impact is shown or, without impacts, the moment of the most contacts. If no later
step has more contacts than the first, as on a slope, the end is shown, since nothing has moved yet in the first step.
A killed run has recorded neither moment; for such a run, the frame before which contacts dissipated most energy is
shown.
"""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Iterable
from numbers import Real
from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa

from carom.arrays import FloatArray
from carom.errors import RecordingError, SceneError
from carom.recording.read.recorded_scene import recorded_scene
from carom.recording.timelines import STEP
from carom.scene.start import names_of_solids
from carom.scene.units.dimension import TIME
from carom.scene.wording import Names, bodies_called, body_called

if TYPE_CHECKING:
    from carom.recording.read.recorded_data import RecordedData

_MOST_NAMED = 8  # largest number of bodies that a message lists


def body_number(recording: RecordedData, body: int | str) -> int:
    """Return the number of a body: ``body`` is a number, a name, or a text such as "3" ("#3" if a body is called "3").

    Raises RecordingError if there is no such body, or several have this name.
    """
    names, text = recording.bodies.name, str(body)
    if isinstance(body, str):
        found = [number for number, name in enumerate(names) if name == body]
        if len(found) > 1:
            such = f'"#{found[0]}"' if str(found[0]) in names else str(found[0])
            several = f'{len(found)} bodies called "{body}"'
            raise RecordingError(f"{recording.path} has {several}; give a number, such as {such}")
        if found:
            return found[0]
    number = text.removeprefix("#")
    if number.isascii() and number.isdigit() and int(number) < len(names):
        return int(number)
    count = f"its bodies are 0 to {len(names) - 1}" if len(names) > 1 else "its only body is 0"
    own = [name for number, name in enumerate(names) if name not in ("", f"body {number}")]
    near = difflib.get_close_matches(text, own, n=1)
    if not near and text and not text.isdigit():
        near = [name for name in own if name.casefold().startswith(text.casefold())]
    if near:
        others = f'did you mean "{near[0]}"? {count[0].upper()}{count[1:]}'
    else:
        quoted = ", ".join(f'"{name}"' for name in own)
        others = f"{count}, called {quoted}" if own and len(names) <= _MOST_NAMED else count
    raise RecordingError(f'{recording.path} has no body "{body}"; {others}')


def shown_body(recording: RecordedData, body: int | str) -> int:
    """Return the number of a body, see `body_number`; also raises RecordingError if a clip does not show the body."""
    number, names, shown = body_number(recording, body), recording.bodies.name, recording.shown
    if number not in shown:
        called, others = body_called(number, names[number]), bodies_called(shown, names)
        raise RecordingError(f"{recording.path} does not contain {called}: it is a clip of {others}")
    return number


def split_at_commas(text: str, names: Iterable[str]) -> list[str]:
    """Split a text at its commas, except within a name."""
    whole = {name for name in names if "," in name}
    most = max((name.count(",") + 1 for name in whole), default=1)
    pieces, parts = text.split(","), []
    while pieces:
        joined = [",".join(pieces[:count]).strip() for count in range(min(most, len(pieces)), 1, -1)]
        parts.append(next((name for name in joined if name in whole), pieces[0].strip()))
        del pieces[: parts[-1].count(",") + 1]
    return parts


def names_of(recording: RecordedData) -> Names:
    """Return the names of all bodies, planes and walls; planes are unnamed if this version cannot read the scene."""
    if recording.engine:
        return Names(recording.bodies.name, str(recording.info.get("plane_names", "")).split("\n"))
    try:
        planes = names_of_solids(recorded_scene(recording))
    except (RecordingError, SceneError):
        planes = []
    return Names(recording.bodies.name, planes)


def check_times(**times: object) -> None:
    """Raise a RecordingError if a time, given under its argument's name, is neither a number nor None."""
    for name, time in times.items():
        is_time = isinstance(time, Real) and not isinstance(time, bool) and not math.isnan(time)
        if time is not None and not is_time:
            raise RecordingError(f"{name} = {time!r}: a time is a number, in seconds")


_RELATIVE_TOLERANCE = 1e-8  # `carom inspect` prints nine digits of a time, which people type again


def moment(recording: RecordedData, at: float | None) -> float:
    """Return the simulated time (s) to show; see `Recording.moment`."""
    recording.require_frames()
    times = _column(recording.fingerprints(), "time")
    if at is not None:
        _refuse_outside(recording, times, at, at, recording.units.text(at, TIME, ".9g"))
        return at
    if not recording.shows_all:
        # in a clip of some bodies: the recorded impact with the largest impulse, or otherwise the end
        last = float(times[-1])
        if not recording.records_contacts:
            return last
        found = recording.impacts()
        return float(found["time"][int(np.argmax(found["normal_impulse"].to_numpy()))].as_py()) if len(found) else last
    from_start = recording.closing.get("moments.contacts.step") == 1  # for example, a ball that rolls
    for name in ("impact", "contacts"):
        known = float(recording.closing.get(f"moments.{name}.time", np.nan))
        if times[0] <= known <= times[-1] and not (name == "contacts" and from_start):
            return known
    energy = recording.energy()
    if "restitution" in energy.column_names:
        taken = _column(energy, "restitution")
        taken = taken + (_column(energy, "friction") if "friction" in energy.column_names else 0.0)
        lost = np.diff(taken, prepend=taken[:1])
        if from_start and lost.max() > 0:  # halfway through its slide, a ball has a path and still slides
            return float(_column(energy, "time")[np.argmax(taken >= 0.5 * taken.max())])
        if lost.max() > 0:
            return float(_column(energy, "time")[np.argmax(lost)])
    steps = recording.steps()
    if not from_start and "contacts" in steps.column_names and _column(steps, "contacts").max() > 0:
        return float(_column(steps, "time")[np.argmax(_column(steps, "contacts"))])
    return float(times[-1])


def interval(recording: RecordedData, start: float | None, end: float | None) -> tuple[float, float]:
    """Return an interval (s), by default the whole recording, with both ends; RecordingError if it has no frames."""
    recording.require_frames()
    check_times(begin=start, end=end)
    first, last = -np.inf if start is None else start, np.inf if end is None else end
    asked = recording.units.span(first, last, TIME, "g")
    if first > last:
        raise RecordingError(f"from {asked}: the end is before the start")
    _refuse_outside(recording, _column(recording.fingerprints(), "time"), first, last, asked)
    return first, last


def _refuse_outside(recording: RecordedData, times: FloatArray, first: float, last: float, asked: str) -> None:
    """Refuse an interval (s) outside the frames and the step before the first frame."""
    begins, ends = float(times[0]), float(times[-1])
    if last < begins and not recording.is_overlay:
        dt = _column(recording.steps("dt"), "dt")
        begins -= float(dt[0]) if len(dt) else 0.0
    if last < begins - tolerance(begins) or first > ends + tolerance(ends):
        whole = recording.units.span(times[0], ends, TIME, ".9g")
        raise RecordingError(f"{recording.path} covers {whole}; {asked} is outside")


def recorded_moments(recording: RecordedData) -> dict[str, float]:
    """Return the times (s) of the moments that `carom inspect` lists, such as the hardest impact, by their names."""
    matches = ((re.fullmatch(r"moments\.([^.]+)\.time", key), value) for key, value in recording.closing.items())
    return {match[1]: float(value) for match, value in matches if match}


def end_of_step(recording: RecordedData, step: int) -> float | None:
    """Return the time (s) at the end of a step; None if the step has no frame."""
    frames = recording.fingerprints()
    rows = np.flatnonzero(frames[STEP].to_numpy() == step)
    return float(frames["time"][int(rows[0])].as_py()) if len(rows) else None


def printed_time(recording: RecordedData, time: float, rounding: float) -> float:
    """Return the recorded time (s) whose printed form is nearest to a time; if none is near, the given time.

    Recorded times are the times of frames, and the moments that `carom inspect` lists, whose steps may have no frame.
    """
    known = np.append(_column(recording.fingerprints(), "time"), list(recorded_moments(recording).values()))
    off = np.abs(known - time)
    near = int(np.argmin(off)) if len(off) else -1
    return float(known[near]) if near >= 0 and off[near] <= rounding else time


def tolerance(time: float) -> float:
    """Return the rounding error (s) of a time that was printed and typed again."""
    return 0.0 if np.isinf(time) else _RELATIVE_TOLERANCE * abs(time)


def goal_of(recording: RecordedData, at: float) -> float:
    """Return the time (s) that a step must reach to contain a time; later times belong to the last recorded step."""
    times = _column(recording.fingerprints(), "time")
    return at if _row_at(times, at) is not None else min(at - tolerance(at), float(times[-1]))


def frame_of(recording: RecordedData, at: float) -> int | None:
    """Return the row of the frame at the end of the step that contains a time (s); None if that step has no frame.

    Times after the last frame belong to the last frame, times before the first frame to the first frame.
    """
    steps = recording.steps("dt")
    times, goal = _column(steps, "time"), at - tolerance(at)
    if (exact := _row_at(times, at)) is not None:
        return exact
    row = min(int(np.searchsorted(times, goal)), len(times) - 1)
    began = times[row] - _column(steps, "dt")[row]
    return row if row == 0 or goal > times[-1] or goal > began else None


def _row_at(times: FloatArray, at: float) -> int | None:
    """Return the row of exactly this time; None without one. After 10⁸ steps, the tolerance exceeds a step."""
    row = int(np.searchsorted(times, at))
    return row if row < len(times) and times[row] == at else None


def _column(table: pa.Table, name: str) -> FloatArray:
    return np.asarray(table[name].to_numpy(), dtype=np.float64)
