"""The moments of a recording that explain it to a reader, in order of time, with captions."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from carom.recording.read.body_lookup import names_of
from carom.recording.read.recorded_impacts import numbered_impacts
from carom.recording.read.recording import Recording
from carom.recording.schema.paths import STEP
from carom.runs.overview import Moment, moments
from carom.runs.report import ENERGY_ERROR, worst_moment
from carom.scene.units.dimension import ANGULAR_IMPULSE, ENERGY, IMPULSE, VELOCITY
from carom.scene.wording import counted
from carom.show.request import Request
from carom.show.supplement import has_trails

MOST_IMPACTS = 10  # number of impacts up to which each impact is a moment
HARDEST = 3  # number of impacts, the hardest ones, that are moments in a run with more than `MOST_IMPACTS`
FAINTEST = 0.01  # of the largest impulse; weaker impacts explain nothing
_ROUNDING = 1e-9  # of the normal impulse
DEEP = 0.01  # of the smaller radius; a shallower overlap explains nothing


@dataclass(frozen=True, slots=True)
class TellingMoment:
    """A moment, its caption, and the view that shows it."""

    step: int
    time: float  # s
    heading: str
    details: Sequence[str]
    request: Request
    close: bool = False  # whether it is an impact, which a close-up shows


def telling_moments(recording: Recording) -> list[TellingMoment]:
    """Choose the moments.

    They are the initial state, if there are many bodies; all impacts of a run with few impacts, otherwise the hardest
    impacts and the moment with the most contacts; and the end. In addition, there are the worst moment of a run that
    went wrong, a deep overlap, and a large integration error.

    Raises
    ------
    RecordingError
        If the recording has no frame.
    """
    recording.require_frames()
    summary = recording.summary()
    extremes = {moment.name: moment for moment in moments(summary, recording.units)}
    impacts = list(_impacts(recording))
    chosen: list[TellingMoment] = []
    if impacts and len(impacts) <= MOST_IMPACTS and not summary["impacts"]["left_out"]:
        chosen = [moment for _, moment in impacts]
    else:
        if "impact" in extremes:
            between = summary["moments"]["impact"]["between"]
            hardest = _of_extreme(extremes["impact"], close=True)
            same = [one for _, one in impacts if one.step == hardest.step and between and between in one.heading]
            chosen.append(replace(same[0], heading=f"Hardest impact: {between}") if same else hardest)
        for _, moment in sorted(impacts, key=lambda one: -one[0]):
            if len(chosen) < HARDEST and all(moment.step != other.step for other in chosen):
                chosen.append(moment)
        if "contacts" in extremes:
            _add(chosen, _of_extreme(extremes["contacts"]))
    if not has_trails(recording):  # a trail shows where bodies come from
        _add(chosen, _frame(recording, 0, "At the start"))
    _add(chosen, _frame(recording, -1, "At the end"))
    if "overlap" in extremes and summary["moments"]["overlap"]["value"] > DEEP:
        _add(chosen, _of_extreme(extremes["overlap"], close=True))
    if "energy_error" in extremes and summary["moments"]["energy_error"]["value"] > ENERGY_ERROR:
        _add(chosen, _of_extreme(extremes["energy_error"]))
    if recording.warnings() or recording.outcome.startswith(("failed", "disk")):
        time, why = worst_moment(recording)
        table = recording.fingerprints()
        row = min(int(np.searchsorted(table["time"].to_numpy(), time)), table.num_rows - 1)
        step = int(table[STEP][row].as_py())
        _add(chosen, TellingMoment(step, time, _capital(why.splitlines()[0]), (), Request(time)))
    return sorted(chosen, key=lambda moment: (moment.time, moment.step))


def _impacts(recording: Recording) -> Iterator[tuple[float, TellingMoment]]:
    """Yield the impulse (N s) and the moment of each instant at which bodies met hard enough."""
    numbers, table = numbered_impacts(recording)
    times = recording.fingerprints()["time"]
    impulse = np.nan_to_num(table["normal_impulse"].to_numpy())
    time = table["time"].to_numpy()
    inside = np.flatnonzero((time >= times[0].as_py()) & (time <= times[-1].as_py()))
    inside = inside[np.lexsort((-impulse[inside], time[inside]))]  # the hardest impact of an instant comes first
    _, firsts, counts = np.unique(time[inside], return_index=True, return_counts=True)
    loud = FAINTEST * impulse[inside].max(initial=0.0)
    names, units = names_of(recording), recording.units
    rubbing = ("tangential_impulse", "angular_impulse_i")
    for hardest, together in zip(inside[firsts].tolist(), counts.tolist(), strict=True):
        if impulse[hardest] < loud:
            continue
        row: dict[str, Any] = table.slice(hardest, 1).to_pylist()[0]
        number = int(numbers[hardest])
        others = f", and {counted(together - 1, 'impact')} at the same time" if together > 1 else ""
        rubs = row["tangential_impulse"] > _ROUNDING * row["normal_impulse"]
        measured = (
            ("approach {}", "approach_speed", VELOCITY),
            ("impulse {}", "normal_impulse", IMPULSE),
            ("friction {}", "tangential_impulse", IMPULSE),
            ("angular impulse {}", "angular_impulse_i", ANGULAR_IMPULSE),
            ("energy lost {}", "energy_lost", ENERGY),
        )
        details = [
            wording.format(units.text(row[name], dimension, ".4g"))
            for wording, name, dimension in measured
            if row[name] is not None and (name not in rubbing or rubs)
        ]
        heading = f"Impact {number}: {names.of(row['i'])} and {names.of(row['j'])}{others}"
        request = Request(event=f"impact:{number}")
        yield float(impulse[hardest]), TellingMoment(row[STEP], row["time"], heading, details, request, close=True)


def _of_extreme(moment: Moment, *, close: bool = False) -> TellingMoment:
    request = Request(event=moment.name)
    return TellingMoment(moment.step, moment.time, _capital(moment.text), (), request, close)


def _frame(recording: Recording, row: int, heading: str) -> TellingMoment:
    table = recording.fingerprints()
    step, time = (table[name][row].as_py() for name in (STEP, "time"))
    return TellingMoment(step, time, heading, (), Request(time))


def _add(chosen: list[TellingMoment], moment: TellingMoment) -> None:
    """Add a moment; if there is already a moment of the same step, add only the caption to it."""
    for place, other in enumerate(chosen):
        if other.step == moment.step:
            chosen[place] = replace(other, details=(*other.details, moment.heading))
            return
    chosen.append(moment)


def _capital(text: str) -> str:
    return f"{text[0].upper()}{text[1:]}"
