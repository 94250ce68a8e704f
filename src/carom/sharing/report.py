"""Packs a bundle for a bug report: a clip around the time of interest, the scene, versions and measurements."""

from __future__ import annotations

import json
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from carom.display.picture import Shot, try_to_render
from carom.display.request import Request
from carom.errors import PhysicsError, RecordingError, SceneError
from carom.physics.contact.statistics import OVERLAPS
from carom.private_folder import temporary_folder
from carom.recording.edit import bundle
from carom.recording.edit.clip import Clip, clip
from carom.recording.read.named_events import pair_of_extreme
from carom.recording.read.recording import Recording
from carom.recording.schema.series import all_series
from carom.recording.timelines import STEP
from carom.runs.environment import environment
from carom.runs.outcome import (
    COMMAND,
    FAILURES,
    description,
    energy_texts,
    in_words,
    is_worth_a_look,
    overview,
    promise_text,
    value_shown,
)
from carom.runs.replay import replay
from carom.scene.extensions import RELEASE, stamped
from carom.scene.units.dimension import ENERGY, TIME
from carom.scene.units.system import UnitSystem
from carom.scene.wording import command, counted, in_one_line, literal

FRAMES = 120  # largest number of frames in the clip, half of them before the time of interest
ROOM = 7_000_000  # largest number of bytes of the clip before compression
FRAMES_OF_LAW, ROOM_OF_LAW = 20, 200_000  # limits on the frames and bytes of a second clip, which shows a broken law
REPLAY_AT_MOST = 30.0  # s, longest replay of the clip
ENERGY_ERROR = 1e-3  # relative error of the energy above which the error becomes the subject of the report
MOST_WARNINGS = 50
PICTURES = {"bodies": "picture.png", "close-up": "close-up.png"}  # files of pictures, by the names of views
NOT_FINITE = "law-not-finite"  # kind of an event that the audit of another engine finds; a run of carom fails instead
LAWS = ("energy", "law-")  # prefixes of the kinds of events about violated laws
WORST = {  # subjects of a report if nothing went wrong
    "impact": "the hardest impact, {value} of approach (½ μ v_n²)",
    "overlap": "the deepest overlap, {value:.3g}% of the smaller radius",
}
LEDGER = "energy/ledger/"  # prefix of the series of ledger entries


@dataclass(frozen=True, slots=True)
class Report:
    """Description of a bundle."""

    path: Path
    size: int  # bytes
    time: float  # s, the time of interest
    why: str  # the event at the time of interest
    frames: int
    replayed: str  # a sentence about the replay
    picture: str  # the reason for a missing picture; empty if there is one
    replays: bool  # whether `carom replay` accepts the clip


def report(recording: Recording, path: Path, at: float | None = None) -> Report:
    """Pack a bundle of less than 10 MB.

    Parameters
    ----------
    recording
        A whole run, or a clip.
    path
        The ``.zip`` to write.
    at
        s, the time in question; by default the worst moment of the run.

    Raises
    ------
    RecordingError
        If the path does not end in .zip, the recording has no frame, one frame of one body is too large, or the bundle
        cannot be written.
    """
    if path.suffix != ".zip":
        raise RecordingError(f"{path}: a report is a .zip file")
    moment, why = worst_moment(recording) if at is None else (recording.moment(at), "the requested moment")
    with temporary_folder() as folder:
        cut = folder / bundle.CLIP
        excerpt(recording, moment, cut, FRAMES, ROOM)
        small = Recording.open(cut)
        replayed = _replay(small)
        shown, has_pair = _shown(small, moment, why)
        shots = [Shot(shown, view, folder / name) for view, name in list(PICTURES.items())[: 2 if has_pair else 1]]
        evidence = _evidence(recording, small, folder)
        missing = try_to_render(small, shots)
        pictures = {shot.out_png.name: shot.out_png for shot in shots if shot.out_png.exists()}
        recorded = {key: value for key, value in recording.properties.items() if isinstance(value, str | int | float)}
        surroundings = {"recorded": recorded, "reported": environment(0)}
        text = _summary(recording, small, moment, why, replayed, list(pictures), path.name, evidence)
        members: dict[str, bytes | Path] = {
            "README.md": text.encode(),
            "scene.toml": recording.scene_toml.encode(),
            "environment.json": json.dumps(surroundings, indent=2).encode(),
            bundle.CLIP: cut,
            **{path.name: path for path in evidence.values()},
            **pictures,
        }
        size = bundle.pack(path, members)
        if size > bundle.LARGEST:
            path.unlink()
            raise RecordingError(f"{recording.path}: a bundle with a single frame would have {size / 1e6:.3g} MB")
        return Report(path, size, moment, why, small.frames, replayed, missing, not (small.engine or small.is_partial))


def _evidence(recording: Recording, small: Recording, folder: Path) -> dict[str, Path]:
    """If the clip of a bundle does not show a broken law, cut another clip around the law's first frame."""
    begin, end = small.fingerprints()["time"].to_numpy()[[0, -1]]
    found: dict[str, Path] = {}
    for name, law in _laws(recording).items():
        if not begin < law["time"] <= end:
            found[name] = folder / f"law-{name}.rrd"
            excerpt(recording, law["time"], found[name], FRAMES_OF_LAW, ROOM_OF_LAW)
    return found


def _broken(recording: Recording, evidence: dict[str, Path]) -> list[str]:
    """List the broken laws, the first one first, and where the bundle shows each."""
    rows = []
    for name, law in _laws(recording).items():
        time = recording.units.text(law["time"], TIME, ".9g")
        where = evidence[name].name if name in evidence else bundle.CLIP
        frames = counted(law["frames"], "frame")
        rows.append(f"| {name} | {law['step']} | {time} | {frames} | {literal(str(law['text']))} | {where} |")
    head = ["| law | first step | time | in all | what | shown in |", "|---|---|---|---|---|---|"]
    return ["## Broken laws", "", *head, *rows, ""] if rows else []


def _shown(recording: Recording, moment: float, why: str) -> tuple[Request, bool]:
    """Return the view of a report's pictures at a time (s), and whether the subject is two bodies that meet.

    The subject is two bodies if an extreme of the run occurred at this time, or if the run failed at this time while
    bodies touched.
    """
    for name in sorted(WORST, key=lambda name: name not in why):  # two quantities may have their extremes at this time
        if recording.closing.get(f"moments.{name}.time") == moment and pair_of_extreme(recording, name):
            return Request(event=name), True
    for law in _laws(recording).values():
        ends, n = law["bodies"], int(recording.info["bodies"])
        if law["time"] == moment and len(ends) == 2 and ends[0] < n:
            return Request(moment, bodies=",".join(str(end) for end in ends if end < n)), True
    contacts = recording.steps("contacts")["contacts"] if recording.info["collides"] else [0]
    return Request(moment), recording.outcome.startswith("failed") and float(contacts[-1]) > 0.0


def _laws(recording: Recording) -> dict[str, dict[str, Any]]:
    """Return the laws that another engine broke within the recording's frames, in the order of `summary`."""
    if not (recording.engine and recording.frames):
        return {}
    begin, end = recording.fingerprints()["time"].to_numpy()[[0, -1]]
    laws = recording.summary()["laws"]
    return {name: law for name, law in laws.items() if begin <= law["time"] <= end}


def worst_moment(recording: Recording) -> tuple[float, str]:
    """Return the time (s) of a report's subject, and its description.

    The subject is the worst failure: a failed run, or else the first violated law, a missed promise, another warning,
    or an extreme of the run.
    """
    recording.require_frames()
    summary = recording.summary()
    moments: dict[str, Any] = summary["moments"]
    last = float(recording.fingerprints()["time"][-1].as_py())
    if recording.outcome.startswith(FAILURES):
        return last, in_words(recording.outcome)
    warnings = recording.warnings()
    broken = [event for event in warnings if event.kind.startswith(LAWS)]
    for law in _laws(recording).values():
        return law["time"], str(law["text"]).splitlines()[0].rstrip(".")  # the first law in the order of `summary`
    for event in sorted(broken, key=lambda event: event.kind != NOT_FINITE):
        return event.time, event.text.splitlines()[0].rstrip(".")
    for name, verdict in summary["expect"].items():
        if verdict.get("judged", True) and not verdict["met"]:
            worst = verdict if "time" in verdict else moments.get(name.removeprefix("max_"), {})
            between = f", {worst['between']}" if worst.get("between") else ""
            return worst.get("time", last), f"the promise {name} was broken: {promise_text(verdict)}{between}"
    for event in sorted(warnings, key=lambda event: event.kind == "pace"):  # a change of pace is the least harmful
        deepest = moments.get("overlap")
        if event.text.startswith(OVERLAPS) and deepest:
            return deepest["time"], _extreme("overlap", moments, recording.units)
        return event.time, event.text.splitlines()[0].rstrip(".")
    error = moments.get("energy_error")
    # only if no law of the scene permits the error
    if error and error["value"] > ENERGY_ERROR and not recording.engine:
        return error["time"], f"the integration error at a check is largest, {error['value']:.3g} of the energy scale"
    for name in WORST:
        if name in moments and moments[name]["between"] and is_worth_a_look(name, summary):
            return moments[name]["time"], _extreme(name, moments, recording.units)
    moment = recording.moment()
    return moment, "the last frame" if moment == last else "the frame with the largest effect of contacts"


def _extreme(name: str, moments: dict[str, Any], units: UnitSystem) -> str:
    between = f", {moments[name]['between']}" if moments[name]["between"] else ""
    return WORST[name].format(value=value_shown(name, moments[name]["value"], units)) + between


def _replay(recording: Recording) -> str:
    if recording.engine:
        return f"Recorded from {literal(recording.engine)}; it cannot be replayed."
    if recording.is_partial:
        shown, bodies = len(recording.shown), recording.info["bodies"]
        return (
            f"It shows {shown} of {bodies} bodies, the nearest to the event, and has no exact states; only the "
            "whole recording can be replayed."
        )
    try:
        result = replay(recording, consent=lambda seconds: seconds <= REPLAY_AT_MOST)
    except (SceneError, RecordingError, PhysicsError) as error:
        return f"It could not be replayed: {literal(str(error))}"
    if result.same:
        return f"Replayed from step {result.begin}: {result.compared} of {result.frames} frames, same bits."
    if result.difference is None:
        done = f"{result.compared} of {result.frames} frames"
        return f"Not replayed to its end: {result.ended} after {done} with the same bits."
    return f"Replayed from step {result.begin}, **it differs** at {literal(result.difference.text(recording.units))}."


def _summary(
    recording: Recording,
    clip: Recording,
    moment: float,
    why: str,
    replayed: str,
    pictures: list[str],
    name: str,
    evidence: dict[str, Path],
) -> str:
    """Write the summary: the problem, its picture, warnings, the way to repeat it, and further data."""
    times, units = clip.fingerprints()["time"].to_numpy(), recording.units
    span = units.span(times[0], times[-1], TIME, ".9g")
    repeat = f"{command('replay', name)}    # are the bits the same on your machine?"
    lines = description(recording.scene_toml).splitlines()
    version = recording.versions.get("carom", "")
    writer = f"carom {version}" if RELEASE.fullmatch(version) else "the version of carom that recorded it"
    return "\n".join(
        [
            f"# {literal(recording.title)}",
            "",
            f"**{literal(why[0].upper() + why[1:].splitlines()[0])}**, t = {units.text(moment, TIME, '.9g')}.",
            "",
            *(f"![The moment]({picture})" for picture in pictures),
            *([""] if pictures else []),
            *_broken(recording, evidence),
            *_warned(recording),
            "## Repeat it",
            "",
            "```sh",
            *([] if clip.engine or clip.is_partial else [repeat]),
            command("view", name, "--at", f"{units.shown(moment, TIME):.9g}"),
            "```",
            "",
            f"The commands need {writer}: `pip install .` in a copy of its repository, with Python 3.11 "
            f"or newer. Without carom, `pip install rerun-sdk` and `rerun {bundle.CLIP}` show the clip; its texts "
            "Legend and About explain what is drawn, and how to read the numbers.",
            "",
            f"The clip: {counted(clip.frames, 'frame')} from {span}. {replayed}",
            "",
            *([*(f"> {literal(line)}".rstrip() for line in lines), ""] if lines else []),
            "| | |",
            "|---|---|",
            *(
                f"| {literal(name)} | {_code(text) if name == COMMAND else literal(text)} |"
                for name, text in overview(recording)
            ),
            "",
            *_ledger(clip),
        ]
    )


def _ledger(clip: Recording) -> list[str]:
    """Describe the energy balance within the clip."""
    energy = clip.energy()
    if clip.engine:
        texts = energy_texts(clip.summary(), clip.units)
        return ["## Where energy went in the clip", "", *(f"- {literal(text)}" for text in texts), ""]
    paths = (series.path for series in all_series(stamped(clip.info)))
    entries = [path.removeprefix(LEDGER) for path in paths if path.startswith(LEDGER)]
    rows = [(name, "taken out" if name != "stabilisation" else "put in") for name in entries]
    rows = [*rows, ("integration_error", "the integrator's error")]
    changes = [(name, what, energy[name].to_numpy()) for name, what in rows if name in energy.column_names]
    shown = [(name.replace("_", " "), what, clip.units.text(v[-1] - v[0], ENERGY, "+.4g")) for name, what, v in changes]
    table = [f"| {name} | {what} | {change} |" for name, what, change in shown]
    return ["## Where energy went in the clip", "", "| | | |", "|---|---|---|", *table, ""]


def _warned(recording: Recording) -> list[str]:
    """List all warnings."""
    warnings = recording.warnings()
    if not warnings:
        return []
    listed = []
    for event in warnings[:MOST_WARNINGS]:
        first, *further = event.text.splitlines() or [""]
        time = recording.units.text(event.time, TIME, ".9g")
        listed.append(f"- {literal(f't = {time}: {first}')}")
        listed += [f"  - {literal(line.strip())}" for line in further]
    if len(warnings) > MOST_WARNINGS:
        listed.append(f"- … and {len(warnings) - MOST_WARNINGS} more")
    return [f"## Warnings ({len(warnings)})", "", *listed, ""]


def _code(text: str) -> str:
    """Return a text of a recording as code within a row of a table."""
    line = in_one_line(text).replace("|", "\\|")
    fence = "`" * (1 + max(map(len, re.findall("`+", line)), default=0))
    return f"{fence} {line} {fence}" if len(fence) > 1 else f"`{line}`"


MOST_BODIES = 2000  # limit on the bodies in a clip without exact states; up to it, bodies are drawn as ellipsoids
BYTES_OF_A_BODY = 150  # bytes of a body in an exact state and static data; slightly less when compressed
BYTES_DRAWN = 60  # bytes of a body in a frame
MOST_READ = 2_000_000_000  # largest number of bytes of frames that are read to cut out some bodies
COMPRESSED = 4  # largest compression ratio (bodies at rest), which bounds the number of frames to try


def excerpt(recording: Recording, moment: float, path: Path, frames: int, room: int) -> Clip:
    """Cut a clip of at most ``room`` bytes, if possible, and ``frames`` frames, half of them before a moment (s).

    The number of frames is reduced as needed. If a single frame is too large, the clip holds only the bodies nearest to
    the event, without exact states.
    """
    times = recording.fingerprints()["time"].to_numpy()
    middle, bodies = int(np.argmin(np.abs(times - moment))), len(recording.shown)
    if BYTES_OF_A_BODY * int(recording.info["bodies"]) <= 2 * room:
        fitting = min(frames, 1 + COMPRESSED * room // (BYTES_DRAWN * bodies))
        made = _fewer_frames(recording, middle, path, fitting, room, None)
        if made.size <= room or bodies == 1:
            return made
    frames = min(frames, 1 + MOST_READ // (BYTES_DRAWN * bodies))
    step, most = int(recording.fingerprints()[STEP][middle].as_py()), min(MOST_BODIES, max(1, bodies - 1))
    while True:
        made = _fewer_frames(recording, middle, path, frames, room, _nearest(recording, moment, step, most))
        if made.size <= room or most == 1:
            return made
        most //= 2


def _fewer_frames(
    recording: Recording, middle: int, path: Path, frames: int, room: int, bodies: list[int] | None
) -> Clip:
    """Cut as many frames as fit, at least one, with selected bodies and without exact states."""
    times, count = recording.fingerprints()["time"].to_numpy(), frames
    while True:
        first, last = max(0, middle - count // 2), min(len(times) - 1, middle + count // 2)
        made = clip(recording.path, path, times[first], times[last], bodies, exact=bodies is None)
        if made.size <= room or count == 0:
            return made
        count = 0 if count == 1 else max(1, min(count // 2, int(count * room / made.size)))


def _nearest(recording: Recording, moment: float, step: int, count: int) -> list[int]:
    """Return the numbers of the bodies that are drawn nearest to the event at a moment."""
    shown, drawn = np.asarray(recording.shown), recording.drawn_positions(step)
    if drawn is None or len(drawn) != len(shown):
        return [int(body) for body in shown[:count]]
    # drawn position of the event's body, or the middle of all bodies
    moments = [each for each in recording.summary()["moments"].values() if each["time"] == moment]
    places = np.concatenate([np.empty(0, np.int64), *(np.flatnonzero(np.isin(shown, m["bodies"])) for m in moments)])
    apart = drawn - (drawn[places[0]] if len(places) else np.median(drawn, axis=0))
    order = np.argsort(np.sum(apart * apart, axis=1), kind="stable")
    return [int(body) for body in shown[np.sort(order[:count])]]
