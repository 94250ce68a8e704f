"""Goes on from a moment of a recording, and records it beside what it did before."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from carom import Recording
from carom.extend import LENGTH, TIME, Forecast, Outcome, Watcher, in_words, simulate, write_forecast
from carom.lab.diff.diff import Diff, diff, overlay
from carom.lab.fork.branch import ForkStart
from carom.lab.fork.ensemble import Ensemble
from carom.private_folder import temporary_folder


@dataclass(frozen=True, slots=True)
class Fork:
    """A branch compared with the recording that it left."""

    outcome: Outcome
    diff: Diff


def fork(start: ForkStart, out: Path, shift: int | None, ulps: int, watch: Watcher | None = None) -> Fork:
    """Run one branch to its end, and write it and the recording into one file.

    Parameters
    ----------
    start
        The state at the fork.
    out
        The ``.rrd`` to write.
    shift, ulps
        Seed and size of a perturbation; see `ForkStart.space`.
    watch
        Called several times a second with where the run stands.

    Raises
    ------
    RecordingError
        If it cannot be written.
    """
    with temporary_folder() as folder:
        part = folder / f"{out.stem}.rrd"
        outcome = simulate(start.space(None, shift, ulps), part, watch=watch)
        branch = Recording.open(part)
        found = diff(start.recording, branch)
        text = text_of(start, found)
        if early := ended_early(outcome):
            text = f"{text}. {early.removesuffix('.')}"
        overlay(start.recording, branch, replace(found, verdict=replace(found.verdict, text=text)), out)
    return Fork(outcome, found)


def ended_early(outcome: Outcome) -> str:
    """Say why a fork stopped before its end; return nothing if it did not, even if it missed a promise."""
    if outcome.status in ("completed", "expectation missed"):
        return ""
    return f"The fork ended early, {in_words(outcome.status)}: {outcome.reason}."


def text_of(start: ForkStart, found: Diff) -> str:
    """Say when a branch left its recording, what is other in it, and how far they are apart in the last frame."""
    changes = ", ".join(
        f"{key} = {_value(found, key, other)}, before {_value(found, key, one)}"
        for key, (one, other) in found.scene.items()
    )
    what = f" with {changes}" if changes else ""
    curve, first, units = found.curve, found.verdict.first, start.scene.unit_system
    forked = f"forked at step {start.checkpoint.step}, t = {units.text(start.checkpoint.time, TIME, '.9g')}{what}"
    last = f"t = {units.text(curve.time[-1], TIME, '.9g')}"
    if first is None:
        return f"{forked}: the same bits up to {last}"
    when, apart, resolved = units.text(curve.time[first], TIME), curve.rms[-1], curve.floor[-1]
    distance = units.text(max(apart, resolved), LENGTH, ".3g")
    return (
        f"{forked}: the first frame that differs is step {curve.step[first]}, t = {when}; at {last} counterparts are "
        f"{'' if apart > resolved else 'less than '}{distance} apart (rms), in a system of "
        f"{units.text(curve.size, LENGTH, '.3g')} at first"
    )


def _value(found: Diff, key: str, written: object) -> str:
    """Return the value of a scene's key, or its default where the scene does not have it."""
    if written is not None:
        return str(written)
    default = found.defaults.get(key)
    return "not given" if default is None else f"{default} by default"


def write_ensemble(start: ForkStart, found: Ensemble, text: str, out: Path) -> None:
    """Write an ensemble for the viewer. RecordingError if it cannot be written."""
    when = start.scene.unit_system.text(start.checkpoint.time, TIME)
    title = f"{start.recording.title}: {len(found.rms)} forks at t = {when}"
    rows = [(chance.time, chance.band[0], chance.probability, chance.band[1]) for chance in found.chances]
    chances = np.array(rows, dtype=np.float64).reshape(-1, 4)
    forecast = Forecast(title, f"# {title}\n\n{text}", found.time, found.reference, found.spread, found.band, chances)
    write_forecast(out, start.recording, forecast)
