"""Compares two recordings: scene, versions, first different frame and impact, growth of the difference."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from pydantic import BaseModel

from carom.arrays import BoolArray, FloatArray, IntArray
from carom.display import overlays
from carom.errors import RecordingError, SceneError
from carom.lab.diff.divergence import (
    SAME_TIME,
    DiffVerdict,
    DistanceCurve,
    Divergence,
    FirstBits,
    FrameAlignment,
    divergence_of,
    first_bits,
    verdict,
)
from carom.recording.read.lookup import tolerance
from carom.recording.read.recorded_impacts import count_at, impacts_by_number
from carom.recording.read.recorded_scene import RecordedBodies
from carom.recording.read.recording import Recording
from carom.recording.timelines import STEP
from carom.scene.load import Scene, scene_from_text
from carom.scene.scene_file import DEEPEST, is_too_deep, line_of_long_key
from carom.scene.units.dimension import TIME
from carom.scene.units.system import UnitSystem
from carom.scene.wording import body_called


@dataclass(frozen=True, slots=True)
class OtherLife:
    """A body that exists at different times in the two recordings, within their common time."""

    body: int
    name: str
    # begin and end (s) in each recording; None in a recording without the body
    spans: tuple[tuple[float, float] | None, tuple[float, float] | None]

    def text(self, units: UnitSystem) -> str:
        """Describe when the body exists in each recording."""
        one, other = ("never" if span is None else units.span(*span, TIME) for span in self.spans)
        return f"{body_called(self.body, self.name)} exists {one} in A, {other} in B"


def other_lives(a: Recording, b: Recording) -> list[OtherLife]:
    """Return the bodies that come or go at different times in the two recordings."""
    if a.lives is None and b.lives is None:
        return []
    ends = [recording.fingerprints()["time"].to_numpy()[[0, -1]] for recording in (a, b)]
    begin, end = max(each[0] for each in ends), min(each[1] for each in ends)
    spans = [_spans(recording, begin, end) for recording in (a, b)]
    found = []
    for body in range(max(map(len, spans))):
        one, other = (each[body] if body < len(each) else np.full(2, np.nan) for each in spans)
        if np.allclose(one, other, rtol=0.0, atol=tolerance(end), equal_nan=True):
            continue
        named = a if body < len(spans[0]) else b
        lives = tuple(None if np.isnan(each[0]) else (float(each[0]), float(each[1])) for each in (one, other))
        found.append(OtherLife(body, named.bodies.name[body], (lives[0], lives[1])))
    return found


def _spans(recording: Recording, begin: float, end: float) -> FloatArray:
    """Return the times of each body's first and last frame within an interval, (n, 2) s; NaN if it has none."""
    table, n = recording.fingerprints(), int(recording.info["bodies"])
    if recording.lives is None:
        return np.tile((begin, end), (n, 1))
    steps, times = table["step"].to_numpy(), table["time"].to_numpy()
    first, last = recording.lives.T
    rows = np.searchsorted(steps, first), np.searchsorted(steps, last, side="right") - 1
    spans = np.stack([times[np.clip(each, 0, len(times) - 1)] for each in rows], axis=1)
    lives = (first >= 0) & (rows[0] < len(times)) & (rows[1] >= 0) & (spans[:, 0] <= end) & (spans[:, 1] >= begin)
    return np.where(lives[:, None], np.clip(spans, begin, end), np.nan)


# The first impact at which two recordings differ.

MOST_SKIPPED = 1000  # limit on the unmatched impacts of a pair in one run; beyond it, the last impacts are not matched
_VALUES = ("nx", "ny", "nz", "approach_speed", "normal_impulse", "tangential_impulse", "energy_lost")


@dataclass(frozen=True, slots=True)
class Impact:
    """One recorded impact."""

    number: int  # number of the impact in its own run, from 1 on
    bodies: tuple[int, int]  # numbers ≥ n are planes and walls
    time: float  # s
    approach_speed: float  # m/s
    normal_impulse: float  # N s
    mode: str


@dataclass(frozen=True, slots=True)
class ImpactPair:
    """An impact in both recordings; None in a recording that lacks the impact."""

    a: Impact | None
    b: Impact | None

    @property
    def time(self) -> float:
        """The time (s) of the impact, in the recording in which it is earlier."""
        return min(impact.time for impact in (self.a, self.b) if impact is not None)


@dataclass(frozen=True, slots=True)
class ImpactDivergence:
    """The impacts of two recordings, compared one by one.

    Impacts of the same two bodies are matched in order; if one run has more impacts, the match minimises the
    differences of times.
    """

    counts: tuple[int, int] | None  # numbers of impacts up to the last common frame; None without such a frame
    compared: int  # number of impacts in both recordings
    first: ImpactPair | None  # the first matched pair of impacts that differs
    # the first impact that only one run has; None if the other run did not record all its impacts
    alone: ImpactPair | None

    @property
    def same(self) -> bool:
        """Whether there is no difference."""
        return self.first is None and self.alone is None and (self.counts is None or self.counts[0] == self.counts[1])


def impact_divergence(a: Recording, b: Recording) -> ImpactDivergence | None:
    """Compare the impacts in both recordings; None if a recording has no contacts or is of another engine."""
    if not (a.records_contacts and b.records_contacts) or a.engine or b.engine:
        return None
    numbers = impacts_by_number(a)[0], impacts_by_number(b)[0]
    tables = a.impacts(), b.impacts()
    ends = tuple(np.stack((table["i"].to_numpy(), table["j"].to_numpy()), axis=1) for table in tables)
    times = tuple(table["time"].to_numpy() for table in tables)
    rows = _matched(ends, times)
    common = [table.take(pa.array(row)) for table, row in zip(tables, rows, strict=True)]
    # times are rounded to the unit of their timeline, a scaled nanosecond
    scales = [1e-9 * float(recording.info["time_scale"]) for recording in (a, b)]
    rounding = 0.0 if scales[0] == scales[1] else max(scales)
    differs: BoolArray = np.abs(np.subtract(*(table["time"].to_numpy() for table in common))) > rounding
    differs |= np.array(common[0]["mode"].to_pylist(), object) != np.array(common[1]["mode"].to_pylist(), object)
    for name in _VALUES:
        in_a, in_b = (table[name].to_numpy() for table in common)
        differs |= (in_a != in_b) & ~(np.isnan(in_a) & np.isnan(in_b))
    first = None
    if differs.any():
        found = np.flatnonzero(differs)
        k = found[np.argmin(np.minimum(*(time[row[found]] for time, row in zip(times, rows, strict=True))))]
        first = ImpactPair(*(_impact(t, n, int(r[k])) for t, n, r in zip(tables, numbers, rows, strict=True)))
    return ImpactDivergence(_counts(a, b), len(rows[0]), first, _alone((a, b), tables, numbers, times, rows))


def _matched(ends: tuple[IntArray, ...], times: tuple[FloatArray, ...]) -> tuple[IntArray, IntArray]:
    """Return the rows of matched impacts in both runs, in order of time in the first run."""
    none = np.empty(0, np.int64)
    found: list[list[IntArray]] = [[none], [none]]
    groups = [_rows_by_ends(each) for each in ends]
    for key in groups[0].keys() & groups[1].keys():
        rows = groups[0][key], groups[1][key]
        short, long = (0, 1) if len(rows[0]) <= len(rows[1]) else (1, 0)
        found[short].append(rows[short])
        nearest = _nearest_in_order(times[short][rows[short]], times[long][rows[long]])
        found[long].append(rows[long][nearest])
    one, other = map(np.concatenate, found)
    order = np.argsort(one, kind="stable")
    return one[order], other[order]


def _rows_by_ends(ends: IntArray) -> dict[tuple[int, int], IntArray]:
    """Return the rows of the impacts of each pair, in ascending order."""
    order = np.lexsort((ends[:, 1], ends[:, 0]))
    groups = np.split(order, np.flatnonzero(np.diff(ends[order], axis=0).any(axis=1)) + 1)
    return {(int(ends[rows[0], 0]), int(ends[rows[0], 1])): rows for rows in groups if len(rows)}


def _nearest_in_order(short: FloatArray, long: FloatArray) -> IntArray:
    """Match each time of the shorter list, in order, with a time of the longer list; minimise the sum of differences.

    The method is dynamic programming over the number of skipped times. If a list has more than `MOST_SKIPPED` surplus
    times, its last times are ignored.
    """
    skips = min(len(long) - len(short), MOST_SKIPPED)
    if skips == 0:
        return np.arange(len(short))
    cost, taken = np.zeros(skips + 1), np.empty((len(short), skips + 1), np.int64)
    for k, time in enumerate(short):
        best = np.minimum.accumulate(cost)  # lowest cost so far with at most this many skipped impacts
        first = np.maximum.accumulate(np.where(cost == best, np.arange(skips + 1), 0))
        taken[k] = first
        cost = best + np.abs(long[k : k + skips + 1] - time)
    skipped = int(np.argmin(cost))
    chosen = np.empty(len(short), np.int64)
    for k in range(len(short) - 1, -1, -1):
        chosen[k] = k + skipped
        skipped = int(taken[k, skipped])
    return chosen


def _alone(
    recordings: tuple[Recording, Recording],
    tables: tuple[pa.Table, ...],
    numbers: tuple[IntArray, ...],
    times: tuple[FloatArray, ...],
    rows: tuple[IntArray, IntArray],
) -> ImpactPair | None:
    """Return the first impact, within the common time, that is certainly missing in one run; None if there is none."""
    spans = [recording.fingerprints()["time"].to_numpy() for recording in recordings]
    begin, end = max(span[0] for span in spans), min(span[-1] for span in spans)
    found: list[ImpactPair] = []
    for own, other in ((0, 1), (1, 0)):
        if int(tables[other].schema.metadata[b"left_out"]):
            continue  # the impact may have happened without being recorded
        inside = (times[own] > begin) & (times[own] <= end)
        inside[rows[own]] = False
        if inside.any():
            impact = _impact(tables[own], numbers[own], int(np.argmax(inside)))
            found.append(ImpactPair(impact, None) if own == 0 else ImpactPair(None, impact))
    return min(found, key=lambda pair: pair.time, default=None)


def _counts(a: Recording, b: Recording) -> tuple[int, int] | None:
    """Count all impacts, recorded or not, up to the last frame that has the same time in both recordings."""
    frames = [recording.fingerprints() for recording in (a, b)]
    times = [table["time"].to_numpy() for table in frames]
    end = min(time[-1] for time in times) * (1.0 + SAME_TIME)
    rows = [int(np.searchsorted(time, end, side="right")) - 1 for time in times]
    if min(rows) < 0 or abs(times[0][rows[0]] - times[1][rows[1]]) > SAME_TIME * abs(end):
        return None
    counts = [count_at(r, int(f[STEP][row].as_py())) for r, f, row in zip((a, b), frames, rows, strict=True)]
    return counts[0], counts[1]


def _impact(table: pa.Table, numbers: IntArray, row: int) -> Impact:
    (values,) = table.slice(row, 1).to_pylist()
    measured = (values[name] for name in ("time", "approach_speed", "normal_impulse", "mode"))
    return Impact(int(numbers[row]), (values["i"], values["j"]), *measured)


MOST_APART = 3  # largest number of bodies that are named


@dataclass(frozen=True, slots=True)
class MomentApart:
    """The difference in one common frame, and the bodies that are farthest apart there."""

    step: int  # step in the first recording
    time: float  # s
    rms: float  # m, rms distance between counterparts
    energy: float  # J, energy of the second run minus the first
    bodies: tuple[int, ...]  # bodies that are farthest apart, the farthest first; none if all positions are the same
    apart: tuple[float, ...]  # m, distances of these bodies between the recordings


def moment_apart(matched: FrameAlignment, curve: DistanceCurve, time: float, shown: Sequence[int]) -> MomentApart:
    """Return the difference of the bodies with the numbers ``shown`` in the common frame nearest to a time (s)."""
    k = int(np.argmin(np.abs(curve.time - time)))
    one, other, _ = matched.everywhere(k)
    apart = np.nan_to_num(np.linalg.norm(other - one, axis=1))
    most = [row for row in np.argsort(-apart, kind="stable")[:MOST_APART].tolist() if apart[row] > 0.0]
    bodies, furthest = tuple(shown[row] for row in most), tuple(float(apart[row]) for row in most)
    values = float(curve.time[k]), float(curve.rms[k]), float(curve.energy[k])
    return MomentApart(int(curve.step[k]), *values, bodies, furthest)


@dataclass(frozen=True, slots=True)
class Diff:
    """Two recordings compared."""

    paths: tuple[Path, Path]
    scene: dict[str, tuple[Any, Any]]  # keys that differ; None where a scene omits the key
    defaults: dict[str, Any]  # values of keys that one scene omits
    environment: dict[str, tuple[Any, Any]]  # versions, machine and command, if they differ
    frames: tuple[int, int]
    matched_by: str  # "step", or "sim_time" if dt differs
    curve: DistanceCurve
    divergence: Divergence | None
    verdict: DiffVerdict
    impacts: ImpactDivergence | None  # None if either recording has no contacts or is of another engine
    first_bits: FirstBits | None = None  # None unless both runs have exact states of the first frame that differs
    engines: tuple[str, str] = ("", "")  # engines of the runs; empty for carom
    lives: Sequence[OtherLife] = ()  # bodies that exist for different times in the two runs
    moment: MomentApart | None = None  # None unless a moment was given

    @property
    def same(self) -> bool:
        """Whether common frames and impacts have the same bits or, with another engine, do not differ measurably."""
        return self.verdict.kind == "same" and (self.impacts is None or self.impacts.same)


def diff(a: Recording, b: Recording, moment: float | None = None) -> Diff:
    """Compare two recordings, with frames matched as in `FrameAlignment`; describe the frame nearest to ``moment`` (s).

    Raises
    ------
    RecordingError
        If the recordings have no frame in common, show different bodies or several runs, or cannot be read.
    """
    for recording in (a, b):
        recording.refuse_overlay()
    first, second = (recording.units.named if recording.units.own else "SI" for recording in (a, b))
    if first != second:
        raise RecordingError(
            f"{a.path} is in {first or 'no units'} and {b.path} in {second or 'no units'}; they cannot be compared"
        )
    matched = FrameAlignment(a, b)
    curve = matched.curve()
    divergence = divergence_of(curve)
    engines, environment = (a.engine, b.engine), differing(a.properties, b.properties)
    written = {} if any(engines) else differing(_scene(a), _scene(b))
    if any(engines):  # the scene and environment of another engine's run are unknown
        environment = {key: values for key, values in environment.items() if None not in values and key != "engine"}
    same = _written_otherwise(a, b, written)
    scene = {key: values for key, values in written.items() if key not in same}
    defaults = _defaults(a, b, scene)
    judged = verdict(curve, divergence, a.units)
    step = None if judged.first is None or matched.by != "step" else int(curve.step[judged.first])
    return Diff(
        paths=(a.path, b.path),
        scene={key: values for key, values in scene.items() if key not in defaults or defaults[key] not in values},
        defaults=defaults,
        environment=environment,
        frames=(a.frames, b.frames),
        matched_by=matched.by,
        curve=curve,
        divergence=divergence,
        verdict=judged,
        impacts=impact_divergence(a, b),
        first_bits=None if step is None else first_bits(a, b, step),
        engines=engines,
        lives=other_lives(a, b),
        moment=None if moment is None else moment_apart(matched, curve, moment, a.shown),
    )


def overlay(a: Recording, b: Recording, found: Diff, out: Path) -> None:
    """Write both runs into one recording for the viewer. Raises RecordingError if the file cannot be written."""
    matched = FrameAlignment(a, b)
    text = f"{found.verdict.text[0].upper()}{found.verdict.text[1:]}."
    curve = found.curve
    pairs = (
        overlays.MatchedFrames(int(curve.step[k]), float(curve.time[k]), *matched.everywhere(k)[:2])
        for k in range(len(curve.step))
    )
    series = {"rms": np.where(curve.seen, curve.rms, np.nan), "energy": np.abs(curve.energy)}
    overlays.write_overlay(out, a, b, pairs, len(matched), series, text)


def differing(a: Mapping[str, Any], b: Mapping[str, Any]) -> dict[str, tuple[Any, Any]]:
    """Return the keys whose values differ, with both values; None for an absent key."""
    keys = [*a, *(key for key in b if key not in a)]
    return {key: (a.get(key), b.get(key)) for key in keys if a.get(key) != b.get(key)}


def _scene(recording: Recording) -> dict[str, Any]:
    """Read the scene's keys, dotted: ``time.max_dt``, ``body.0.radius``."""
    text = recording.scene_toml
    try:
        if line_of_long_key(text) is not None or is_too_deep(document := tomllib.loads(text)):
            raise RecordingError(f"the scene in {recording.path} is nested more than {DEEPEST} levels deep")
        return _flat(document)
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        raise RecordingError(f"the scene in {recording.path} cannot be read: {error}") from error


def _defaults(a: Recording, b: Recording, differing: Mapping[str, tuple[Any, Any]]) -> dict[str, Any]:
    """Return the defaults of one scene for keys that only the other scene sets."""
    defaults: dict[str, Any] = {}
    for recording, own in ((a, 0), (b, 1)):
        missing = [key for key, values in differing.items() if values[own] is None]
        if missing:
            scene = _validated(recording)
            defaults |= {key: value for key in missing if (value := _value(scene, key)) is not None}
    return defaults


def _written_otherwise(a: Recording, b: Recording, differing: Mapping[str, tuple[Any, Any]]) -> set[str]:
    """Return the keys whose values are equal, but written in different units."""
    both = {key: values for key, values in differing.items() if None not in values}
    with_unit = [key for key, values in both.items() if any(isinstance(value, str) for value in values)]
    if not with_unit:
        return set()
    one, other = _validated(a), _validated(b)
    return {key for key in with_unit if (value := _value(one, key)) is not None and value == _value(other, key)}


def _validated(recording: Recording) -> Scene | None:
    try:
        return scene_from_text(recording.scene_toml, f"the scene in {recording.path}", bodies=RecordedBodies(recording))
    except SceneError:  # the scene belongs to another version
        return None


def _value(scene: Scene | None, key: str) -> Any:
    """Return the value of a dotted key as in TOML; None if it is absent."""
    node: Any = scene
    for name in key.split("."):
        if isinstance(node, tuple):
            node = node[int(name)] if name.isdigit() and int(name) < len(node) else None
        else:
            node = getattr(node, name, None) if name in getattr(type(node), "model_fields", {}) else None
    if isinstance(node, BaseModel):
        return None
    return list(node) if isinstance(node, tuple) else node


def _flat(document: Any, before: str = "") -> dict[str, Any]:
    items: list[tuple[str, Any]]
    if isinstance(document, dict):
        items = list(document.items())
    elif isinstance(document, list) and document and all(isinstance(value, dict) for value in document):
        items = [(str(k), value) for k, value in enumerate(document)]
    else:
        return {before: document}
    flat: dict[str, Any] = {}
    for key, value in items:
        flat |= _flat(value, f"{before}.{key}" if before else key)
    return flat
