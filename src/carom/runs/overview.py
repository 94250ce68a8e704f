"""Describes a run or a recording in words: its end, errors, counts and moments, and an overview in rows of text."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import takewhile
from typing import Any

from carom.contact_table import ROUNDED_OVERLAP
from carom.recording.read.recording import Recording
from carom.scene.scene_file import starter
from carom.scene.units.dimension import ENERGY, RATE, TIME
from carom.scene.units.system import UnitSystem
from carom.scene.wording import counted

MOMENTS = {
    "impact": "hardest impact, {value} of approach (½ μ v_n²)",
    "overlap": "deepest overlap, {value:.3g}% of the smaller radius",
    "contacts": "most contacts, {value:.0f}",
    "energy_error": "largest integration error at a check, {value:.2e} of the energy scale",
}
OF_ENGINES = {"energy_error": "largest change of the energy without contact, {value:.2e} of the energy scale"}
EACH = "each"  # impacts during the drift of a step
ONCE_A_STEP = "once a pair and step"  # impacts detected at the end of a step
_DISK = "disk"
_FAILED = "recording failed"


def counts_text(contact_steps: int, impacts: int | None, each: str | None, summed_over: str = "steps") -> str:
    """Describe the numbers of contacts and of impacts.

    Parameters
    ----------
    contact_steps
        Pairs that touched, summed over the steps, or over the recorded frames.
    impacts
        Contacts that closed faster than the rest speed; None if they were not counted.
    each
        How impacts were counted: `EACH`, `ONCE_A_STEP`, or None if unknown.
    summed_over
        "steps", or "frames" if only the frames are known, as in a clip.
    """
    if summed_over == "frames":
        return (
            f"{counted(contact_steps, 'contact')} in the recorded frames (pairs that touch, summed over these frames)"
        )
    steps = f"{counted(contact_steps, 'contact-step')} (pairs that touch, summed over steps)"
    if impacts is None:
        return steps
    how = f" (counted {each})" if each not in (None, EACH) else ""
    return f"{counted(impacts, 'impact')}{how}, {steps}"


def overlap_text(deepest: float) -> str:
    """Describe the deepest overlap over the smaller radius; empty for overlaps by rounding."""
    return f"deepest overlap {100.0 * deepest:.3g}% of the smaller radius" if deepest > ROUNDED_OVERLAP else ""


def in_words(outcome: str) -> str:
    """Describe a status, with its reason if there is one; ``disk`` means that the recording could not be written."""
    return _FAILED + outcome.removeprefix(_DISK) if outcome == _DISK or outcome.startswith(f"{_DISK}:") else outcome


def error_text(error: float) -> str:
    """Return a relative error with three digits, or 0."""
    return f"{error:.2e}" if error else "0"


def accuracy_text(accuracy: Mapping[str, float], units: UnitSystem) -> str:
    """Describe whether a run kept its accuracy; for the keys see `carom.runs.run.kept_accuracy`."""
    until = f"up to t = {units.text(accuracy['horizon'], TIME)} only" if "horizon" in accuracy else "to the end"
    if "looked" in accuracy:
        until += f" (the budget of the trial runs ended at t = {units.text(accuracy['looked'], TIME)})"
    per = f" /{units.unit(TIME)}" if units.unit(TIME) else ""
    exponent = f"largest Lyapunov exponent over that time {units.shown(accuracy['lyapunov'], RATE):.3g}{per}"
    return f"{accuracy['requested']:g} kept {until}; {exponent}"


@dataclass(frozen=True, slots=True)
class Moment:
    """A time at which a quantity was largest."""

    name: str  # of `MOMENTS`; empty for another moment
    text: str  # the quantity, and the bodies
    step: int
    time: float  # s


def moments(summary: dict[str, Any], units: UnitSystem) -> list[Moment]:
    """Describe the moments of a recording's summary."""
    found = []
    for name, wording in (MOMENTS | (OF_ENGINES if summary["scene"].get("engine") else {})).items():
        moment = summary["moments"].get(name)
        if moment and is_worth_a_look(name, summary):
            between = f", {moment['between']}" if moment["between"] else ""
            value = value_shown(name, moment["value"], units)
            found.append(Moment(name, wording.format(value=value) + between, moment["step"], moment["time"]))
    return found


def is_worth_a_look(name: str, summary: dict[str, Any]) -> bool:
    """Return whether a moment of a recording's summary is of interest.

    Overlaps due to rounding, an error of 0 and the fastest approach of resting contacts are not of interest.
    """
    if name == "impact":
        return bool(summary["contacts"].get("impacts") != 0)
    least = ROUNDED_OVERLAP if name == "overlap" else 0.0
    return bool(summary["moments"][name]["value"] > least)


def value_shown(name: str, value: float, units: UnitSystem) -> float | str:
    """Return the printed value of a moment: an impact with its unit, an overlap in per cent."""
    if name == "impact":
        return units.text(value, ENERGY, ".4g")
    return 100.0 * value if name == "overlap" else value


def energy_texts(summary: dict[str, Any], units: UnitSystem) -> list[str]:
    """Describe the change of the energy and its known reasons.

    In another engine's run, only states are known. Without impulses, the work of contacts cannot be distinguished from
    errors.
    """
    energy = summary["energy"]
    first, last = (units.text(energy[when], ENERGY) for when in ("initial", "final"))
    texts, worst = [f"{first} at first, {last} at last"], error_text(energy["max_error"])
    if not summary["scene"].get("engine"):
        return [*texts, f"integration error at most {worst} of the energy scale at the checks"]
    if summary["contacts"]["total"] or energy["change_in_contact"]:
        change = units.text(energy["change_in_contact"], ENERGY, "+.4g")
        unjudged = " or are not judged" if summary["judged"] < summary["bodies"] else ""
        texts.append(
            f"{change} while bodies touched{unjudged}: by contacts and errors of the engine, not distinguished"
        )
    if not energy["max_error"]:
        return [*texts, "no change without contact"]
    change = units.text(energy["change_without_contact"], ENERGY, "+.4g")
    return [*texts, f"{change} without contact, an error: at most {worst} of the energy scale"]


def overview(recording: Recording) -> list[tuple[str, str]]:
    """Return names and texts: command, outcome, length, energy, contacts, promises, versions, machine."""
    whole, units = recording.summary(), recording.units
    contacts = whole["contacts"]
    impacts = contacts.get("impacts"), contacts.get("impacts_counted")
    counts = counts_text(contacts["total"], *impacts, contacts["summed_over"])
    return [
        ("command", str(recording.properties.get("command", ""))),
        ("outcome", in_words(whole["outcome"])),
        (
            "run",
            f"{counted(whole['bodies'], 'body')}, {counted(whole['steps'], 'step')}, "
            f"{units.text(whole['sim_time'], TIME)} simulated",
        ),
        ("energy", "; ".join(energy_texts(whole, units))),
        ("contacts", "; ".join(filter(None, (counts, overlap_text(contacts["max_overlap"] or 0.0))))),
        *((f"promise {name}", _promise(verdict)) for name, verdict in whole["expect"].items()),
        ("versions", ", ".join(f"{package} {version}" for package, version in recording.versions.items())),
        ("machine", f"{recording.properties.get('cpu', '')}, {recording.properties.get('platform', '')}"),
    ]


def promise_text(verdict: dict[str, Any]) -> str:
    """Describe the measurement and the promise."""
    return f"{verdict['measured']:.3g}, {verdict.get('bound', 'at most')} {verdict['limit']:.3g}"


def _promise(verdict: dict[str, Any]) -> str:
    kept = "kept" if verdict["met"] else "MISSED"
    if not verdict.get("judged", True):
        kept = "not checked, since the run did not end at its duration"
    return f"{promise_text(verdict)}: {kept}"


def headline(recording: Recording) -> list[tuple[str, str]]:
    """Return the quantities that distinguish recordings for a reader: names and texts."""
    whole, units = recording.summary(), recording.units
    impacts = whole["contacts"].get("impacts")
    first, last = (units.text(whole["energy"][when], ENERGY, ".4g") for when in ("initial", "final"))
    return [
        ("bodies", str(whole["bodies"])),
        ("simulated", units.text(whole["sim_time"], TIME)),
        *([] if impacts is None else [("impacts", str(impacts))]),
        ("energy", first if first == last else f"{first} → {last}"),
    ]


def description(scene: str) -> str:
    """Return the description in a scene's text or, without one, the comment at its head, as paragraphs of lines."""
    try:
        own = tomllib.loads(scene).get("description")
    except tomllib.TOMLDecodeError:
        return ""
    comment = _head_comment(scene)
    return str(own or "").strip() or ("" if comment == _head_comment(starter()) else comment)


def _head_comment(scene: str) -> str:
    """Return the comment lines before the first key; a line that begins like "Look for: " begins a paragraph."""
    lines = takewhile(lambda line: line.startswith("#"), scene.splitlines())
    text = "\n".join(line.removeprefix("#").strip() for line in lines if not line.startswith("#:"))
    return re.sub(r"\n+(?=[A-Z][a-z ]+: )", "\n\n", text).strip()


def problems(recording: Recording, most: int) -> list[str]:
    """Return what went wrong in a run: its end, broken promises, and at most ``most`` warnings."""
    promises = recording.summary()["expect"]
    missed = [
        f"promise {name} missed: {promise_text(verdict)}"
        for name, verdict in promises.items()
        if verdict.get("judged", True) and not verdict["met"]
    ]
    ended = [] if recording.outcome == "completed" or missed else [in_words(recording.outcome)]
    warnings = recording.warnings()
    warned = [f"t = {recording.units.text(event.time, TIME)}: {event.text}" for event in warnings[:most]]
    more = [f"… and {len(warnings) - most} more warnings"] if len(warnings) > most else []
    return [*ended, *missed, *warned, *more]
