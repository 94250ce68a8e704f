"""The outcome of a run: closing properties, verdicts on the promises in [expect], and a description in words."""

from __future__ import annotations

import math
import re
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import takewhile
from typing import Any, Protocol

from carom.arrays import FloatArray
from carom.contact_table import ROUNDED_OVERLAP
from carom.recording.read.recording import Recording
from carom.recording.schema.header import Scalar
from carom.scene.load import Scene
from carom.scene.scene_file import starter
from carom.scene.schema.promise import STATES
from carom.scene.units.dimension import ENERGY, RATE, TIME
from carom.scene.units.system import SI, UnitSystem
from carom.scene.wording import command_of_a_file, counted
from carom.state.books import Extreme, Extremes


@dataclass(frozen=True, slots=True)
class Verdict:
    """A promise: its limit, the measured value, and the time of the worst value.

    In a run of another length, a promise about the end is not judged, and counts as met.
    """

    name: str
    limit: float
    measured: float
    worst: Extreme | None = None  # the worst moment; None if the criterion has no such moment
    at_least: bool = False  # whether the limit is a lower bound
    note: str = ""  # explains the measured quantity if its name does not
    promised_at: float | None = None  # s, promised end if the run ended at another time

    @property
    def judged(self) -> bool:
        """Whether the promise applies to this run."""
        return self.promised_at is None

    @property
    def met(self) -> bool:
        """Whether the promise was kept or is not judged; a measured NaN breaks the promise."""
        if not self.judged:
            return True
        return self.measured >= self.limit if self.at_least else self.measured <= self.limit

    @property
    def bound(self) -> str:
        """The kind of bound, in words."""
        return "at least" if self.at_least else "at most"

    def __str__(self) -> str:
        return self.text(SI)

    def text(self, units: UnitSystem) -> str:
        """Describe the promise and the measurement, with times in the units of the scene."""
        missed = "" if self.met else "; missed"
        if self.promised_at is not None:
            missed = f" at t = {units.text(self.promised_at, TIME)}; not judged"
        note = f", {self.note}" if self.note else ""
        return f"{self.name}: {self.measured:.3g}{note} ({self.bound} {self.limit:.3g}{missed})"


class EndState(Protocol):
    """The state of the bodies at the end of a run; None if it is not known."""

    @property
    def position(self) -> FloatArray | None:
        """Positions, (n, 3) m."""

    @property
    def velocity(self) -> FloatArray | None:
        """Velocities, (n, 3) m/s."""

    @property
    def angular_velocity(self) -> FloatArray | None:
        """Angular velocities, (n, 3) rad/s."""


def judge(scene: Scene, extremes: Extremes, time: float, state: EndState | None = None) -> list[Verdict]:
    """Compare every promise of a scene with the extremes of its run, which ended at ``time`` (s), and its last state.

    The error of a quantity that the scene does not conserve is infinite: for instance, of angular momentum in a
    periodic box, or of any momentum if something is fixed. The final kinetic energy, the largest number of impacts and
    the states are judged only if the run ends at the promised time. The smallest number of impacts and the warnings are
    also judged if the run ends later. An unknown state breaks its promise.
    """
    expect, end = scene.expect, scene.expect.duration or scene.time.duration
    at_end, by_then = end if time != end else None, end if time < end else None
    elsewhere = {"final_kinetic": at_end, "most_impacts": at_end, "impacts": by_then}
    worst: dict[str, Extreme | None] = {
        "energy_error": extremes.energy_fault,
        "energy_gain": extremes.energy_gain,
        "momentum_error": extremes.momentum_error,
        "angular_momentum_error": extremes.angular_momentum_error,
        "max_overlap": extremes.overlap,
        "final_kinetic": extremes.kinetic,
        "impacts": None,
        "most_impacts": None,
        "contact_audit": extremes.contact_audit,
        "dissipation_error": extremes.dissipation_error,
    }
    without = {  # measured values of the criteria that have no worst moment
        **dict.fromkeys(("energy_error", "max_overlap", "dissipation_error"), 0.0),
        **dict.fromkeys(("impacts", "most_impacts"), extremes.impacts),
    }
    gained = extremes.energy_fault is not None and extremes.energy_fault is not extremes.energy_error
    notes = {"energy_error": "added by contact impulses"} if gained else {}
    verdicts = []
    for name, extreme in worst.items():
        if (limit := getattr(expect, name)) is not None:
            value = without.get(name, math.inf) if extreme is None else extreme.value
            note, promised_at = notes.get(name, ""), elsewhere.get(name)
            verdicts.append(Verdict(name, limit, value, extreme, name == "impacts", note, promised_at))
    return [*verdicts, *_states(scene, state, at_end)] + [
        Verdict(f"warned_{kind}", 1.0, float(kind in extremes.warned), at_least=True, promised_at=elsewhere["impacts"])
        for kind in expect.warned
    ]


def _states(scene: Scene, state: EndState | None, promised_at: float | None) -> Iterator[Verdict]:
    """Yield a verdict, in the units of the scene, for each expected value of a body's state."""
    numbers, units = [body.name for body in scene.body], scene.unit_system
    for expected in scene.expect.state:
        number = numbers.index(expected.body)
        for name, value, error in expected.values:
            found: FloatArray | None = getattr(state, name, None)
            off = math.nan if found is None else math.dist(found[number].tolist(), value)
            limit, measured = (units.shown(each, STATES[name]) for each in (error, off))
            unit = units.unit(STATES[name])
            note = f'error of "{expected.body}"' + (f" in {unit}" if unit else "")
            yield Verdict(f"{name}_{number}", limit, measured, note=note, promised_at=promised_at)


def closing_of(extremes: Extremes) -> dict[str, Scalar]:
    """Return the extremes of a run, with the names of bodies and planes, under the dotted keys of `outcome`."""
    largest = {
        "momentum.max_error": extremes.momentum_error,
        "angular_momentum.max_error": extremes.angular_momentum_error,
        "energy.max_error": extremes.energy_error,
        "energy.contact_gain": extremes.contact_gain,
        "contacts.max_overlap": extremes.overlap,
    }
    summary: dict[str, Scalar] = {
        "contacts.total": extremes.total_contacts,
        "contacts.impacts": extremes.impacts,
        "energy.reference": extremes.energy_scale,  # J; "energy.scale" is a key that the viewer cannot load
        **{key: extreme.value for key, extreme in largest.items() if extreme is not None},
    }
    for name in ("energy_error", "impact", "overlap", "contacts"):
        moment: Extreme | None = getattr(extremes, name)
        if moment is not None:
            key = f"moments.{name}"
            summary |= {f"{key}.value": moment.value, f"{key}.step": moment.step, f"{key}.time": moment.time}
            summary[f"{key}.bodies"] = ",".join(map(str, moment.bodies))
            summary[f"{key}.planes"] = ",".join(map(str, moment.planes))
            summary[f"{key}.between"] = moment.between
    return summary


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
# label in the overview: whoever pastes the command must trust the recording's sender
COMMAND = "command, as the recording says"
FAILURES = ("failed", _DISK, "error")  # statuses of runs that an error ended
_FAILED = "recording failed"


def counts_text(contact_steps: int, impacts: int | None, each: str | None, summed_over: str = "steps") -> str:
    """Describe the numbers of contacts and of impacts.

    ``contact_steps`` counts pairs that touch, summed over steps, or over "frames" if only the frames are known, as in a
    clip. Impacts are contacts that closed faster than the rest speed, counted `EACH` or `ONCE_A_STEP`; None: unknown.
    """
    if summed_over == "frames":
        return (
            f"{counted(contact_steps, 'contact')} in the recorded frames (pairs that touch, summed over these frames)"
        )
    steps = f"{counted(contact_steps, 'touching pair')}, summed over steps"
    if impacts is None:
        return steps
    how = f" (counted {each})" if each not in (None, EACH) else ""
    return f"{counted(impacts, 'impact')}{how}, {steps}"


def overlap_text(deepest: float) -> str:
    """Describe the deepest overlap, given relative to the smaller radius; empty for overlaps by rounding."""
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
        went_on = "; from there on, errors are extrapolated" if accuracy["kept_until"] > accuracy["looked"] else ""
        until += f" (the budget of the trial runs ended at t = {units.text(accuracy['looked'], TIME)}{went_on})"
    per = f" /{units.unit(TIME)}" if units.unit(TIME) else ""
    exponent = f"largest Lyapunov exponent over that time {units.shown(accuracy['lyapunov'], RATE):.3g}{per}"
    return f"{accuracy['requested']:g} kept {until}; {exponent}"


@dataclass(frozen=True, slots=True)
class Moment:
    """A time at which a quantity was largest."""

    name: str  # name in `MOMENTS`; empty for another moment
    text: str  # names the quantity and the bodies
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

    In a run of another engine, only the states of bodies are known. Without impulses, the work of contacts cannot be
    distinguished from errors.
    """
    energy = summary["energy"]
    first, last = (units.text(energy[when], ENERGY) for when in ("initial", "final"))
    texts, worst = [f"{first} at first, {last} at last"], error_text(energy["max_error"])
    if not summary["scene"].get("engine"):
        return [*texts, f"integration error at most {worst} of the energy scale"]
    work = summary["forces"].get("work", 0.0)
    if work:
        texts.append(f"{units.text(work, ENERGY, '+.4g')} by damping and by forces that the engine's source states")
    if summary["contacts"]["total"] or energy["change_in_contact"] != work:
        change = units.text(energy["change_in_contact"] - work, ENERGY, "+.4g")
        unjudged = " or are not judged" if summary["judged"] < summary["bodies"] else ""
        texts.append(
            f"{change} while bodies touched{unjudged}: by contacts and errors of the engine, not distinguished"
        )
    if not energy["max_error"]:
        return [*texts, "no change without contact"]
    change = units.text(energy["change_without_contact"], ENERGY, "+.4g")
    judged = "an error" if "energy" in summary["laws"] else "which the law admits"
    return [*texts, f"{change} without contact, {judged}: at most {worst} of the energy scale"]


def overview(recording: Recording) -> list[tuple[str, str]]:
    """Return names and texts: command, outcome, length, energy, contacts, promises, versions, machine."""
    whole, units = recording.summary(), recording.units
    contacts = whole["contacts"]
    impacts = contacts.get("impacts"), contacts.get("impacts_counted")
    counts = counts_text(contacts["total"], *impacts, contacts["summed_over"])
    return [
        (COMMAND, command_of_a_file(str(recording.properties.get("command", "")))),
        ("outcome", in_words(whole["outcome"])),
        (
            "run",
            f"{counted(whole['bodies'], 'body')}, {counted(whole['steps'], 'step')}, "
            f"{units.text(whole['sim_time'], TIME)} simulated",
        ),
        ("energy", "; ".join(energy_texts(whole, units))),
        ("contacts", "; ".join(filter(None, (counts, overlap_text(contacts["max_overlap"] or 0.0))))),
        *((f"promise {name}", judged_promise(verdict)) for name, verdict in whole["expect"].items()),
        ("versions", ", ".join(f"{package} {version}" for package, version in recording.versions.items())),
        ("machine", f"{recording.properties.get('cpu', '')}, {recording.properties.get('platform', '')}"),
    ]


def promise_text(verdict: dict[str, Any]) -> str:
    """Describe the measurement and the promise."""
    return f"{verdict['measured']:.3g}, {verdict['bound']} {verdict['limit']:.3g}"


def judged_promise(verdict: dict[str, Any]) -> str:
    """Describe the measurement, the promise, and whether it was kept."""
    kept = "kept" if verdict["met"] else "MISSED"
    if not verdict.get("judged", True):
        kept = "not checked, since the run did not end at its duration"
    return f"{promise_text(verdict)}: {kept}"


def headline(recording: Recording) -> list[tuple[str, str]]:
    """Return names and texts of the quantities by which a reader distinguishes recordings."""
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
    """Return the problems of a run: an early end, broken promises, and at most ``most`` warnings."""
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
