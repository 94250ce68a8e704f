"""`carom inspect`: a summary of a recording."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from carom.event import Event
from carom.scene.units.dimension import LENGTH, TIME
from carom.scene.wording import command, counted, in_one_line
from carom.terminal.answers import CommandAnswer, Part, ShownColumn, ShownFacts, ShownTable, materials_table
from carom.terminal.options import JsonOption, RecordingArgument
from carom.terminal.printing import mention_killed_run, say, warning_lines

if TYPE_CHECKING:
    from carom.scene.units.system import UnitSystem

NOT_RECORDED = "not recorded, or lost"
AROUND = 20  # number of frames in a clip around a moment

Row = tuple[str, str | Iterable[str]]  # a name, and the text or texts printed beside it


def inspect(
    file: RecordingArgument,
    as_json: JsonOption = False,
    check: Annotated[
        bool, typer.Option("--check", help="Exit with 1 if a law of mechanics is broken (recordings of other engines).")
    ] = False,
) -> None:
    """Summarise a recording: outcome, energy, contacts, the moments worth looking at, run time, versions.

    For a file that compares runs, such as one by `carom fork`, it prints their names and the verdict.
    """
    from carom.recording.edit.bundle import opened
    from carom.recording.read.recorded_scene import refuse_missing_extensions
    from carom.recording.read.recording import Recording
    from carom.runs.outcome import description

    mention_killed_run(file)
    with opened(file) as path:
        recording = Recording.open(path)
        # units and kind of file are read while the bundle is unpacked
        units, is_overlay = recording.units, recording.is_overlay
        if is_overlay:  # the runs in a comparison, and the verdict
            summary = {"title": recording.title, **recording.overlaid}
        else:
            refuse_missing_extensions(recording)
            summary = recording.summary() | {"description": description(recording.scene_toml)}
    broken = summary.get("laws", {}) if check and not is_overlay else {}
    parts = _overlay_parts(summary, file) if is_overlay else _parts(summary, file, units)
    CommandAnswer(summary, parts).say(as_json)
    for name, law in broken.items():
        at = f"step {law['step']}, t = {units.text(law['time'], TIME)}"
        say(f"carom: {file}: the law {name} is broken, first at {at}: {in_one_line(str(law['text']))}", err=True)
    if broken:
        raise typer.Exit(1)


def _overlay_parts(summary: dict[str, Any], file: Path) -> Iterator[Part]:
    """Describe a file that compares runs."""
    yield ShownFacts((name, str(text)) for name, text in (*summary.items(), ("next", command("view", file))))


def _parts(summary: dict[str, Any], file: Path, units: UnitSystem) -> Iterator[Part]:
    """Describe a recording."""
    versions = [("versions", ", ".join(f"{name} {version}" for name, version in summary["versions"].items()))]
    rows = (_run(summary, units), _conservation(summary, units), _contacts(summary), _judgements(summary, units))
    yield ShownFacts(chain(*rows, versions))
    yield ""
    if "materials" in summary:
        yield materials_table(summary["materials"])
        yield ""
    if summary["warnings"]:
        yield f"Warnings: {len(summary['warnings'])}"
        yield from warning_lines([Event(**warning) for warning in summary["warnings"]], units, in_full=True)
        yield ""
    yield from _moments(summary, file, units)
    if summary["profile"]:
        yield ""
        yield _profile(summary["profile"])


def _run(summary: dict[str, Any], units: UnitSystem) -> Iterator[Row]:
    """Describe the run, its length and its outcome."""
    from carom.runs.outcome import in_words
    from carom.scene.wording import in_series

    scene, clip = summary["scene"], summary.get("clip")
    yield "scene", f"{scene['title']}, {counted(summary['bodies'], 'body')}"
    if about := " ".join(summary["description"].partition("\n\n")[0].split()):
        yield "about", about
    if scene.get("engine"):
        recorded = "states and contact forces" if summary["contact_forces"] else "only states"
        yield "engine", f"{scene['engine']}; the recording has {recorded}"
        if lives := summary.get("lives"):
            yield "bodies", f"{lives['came']} came after the first frame, {lives['went']} went before the last"
        if summary["judged"] < summary["bodies"]:
            only = f"{summary['judged']} of {counted(summary['bodies'], 'body')}"
            yield "judged", f"{only}; the other bodies are not free spheres"
    if clip:
        of_all = "energies, momenta and numbers of contacts include all bodies"
        few = "" if len(clip["bodies"]) == summary["bodies"] else f", {in_series(clip['names'])}; {of_all}"
        yield "clip of", f"{clip['source']}, {units.span(clip['from'], clip['to'], TIME)}{few}"
    yield "data", summary.get("data_notes", ())
    yield "outcome", in_words(summary["outcome"]) + (" (the whole run)" if clip else "")
    first, last = summary["first_step"], summary["steps"]
    steps = counted(last, "step") if first == 0 and not clip else f"steps {first} to {last}"
    length = summary["sim_time"] - summary["begin"]
    yield "length", f"{counted(summary['frames'], 'frame')}, {steps}, {units.text(length, TIME)} simulated"


def _conservation(summary: dict[str, Any], units: UnitSystem) -> Iterator[Row]:
    """Describe the conservation of energy and momenta."""
    from carom.runs.outcome import energy_texts, error_text

    energy = summary["energy"]
    if math.isnan(energy["initial"]):
        yield "energy", NOT_RECORDED
        return
    linear, angular = summary["momentum"]["max_error"], summary["angular_momentum"]["max_error"]
    yield "energy", energy_texts(summary, units)
    if linear is not None and math.isnan(linear):
        yield "momentum", NOT_RECORDED
        return
    unchecked = "not checked, since planes, walls or fixed bodies may change it"
    yield "momentum", unchecked if linear is None else f"error at most {error_text(linear)}"
    unknown = (
        "not conserved in a periodic box"
        if linear is not None
        else "not checked, since planes, walls or fixed bodies may change it"
    )
    yield "angular momentum", unknown if angular is None else f"error at most {error_text(angular)}"


def _contacts(summary: dict[str, Any]) -> Iterator[Row]:
    """Count contacts and impacts, and name the deepest overlap."""
    from carom.recording.read.recorded_impacts import RecordedImpacts
    from carom.runs.outcome import counts_text, overlap_text

    contacts, texts = summary["contacts"], []
    if contacts["total"] or contacts.get("impacts") or "contacts" in summary["moments"] or summary.get("clip"):
        impacts = contacts.get("impacts"), contacts.get("impacts_counted")
        texts.append(counts_text(contacts["total"], *impacts, contacts["summed_over"]))
    if summary["impacts"]:
        texts.append(f"impacts: {RecordedImpacts(**summary['impacts']).text(contacts.get('impacts'))}")
    if contacts["max_overlap"] is None:
        texts.append("deepest overlap: lost, since part of the file is missing")
    elif deepest := overlap_text(contacts["max_overlap"]):
        texts.append(deepest + (" in these frames" if contacts["summed_over"] == "frames" else ""))
    if parted := summary.get("parted"):
        texts.append(f"parting overlapping bodies added up to {parted:.2%} of their energy in a step")
    yield "contacts", texts


def _judgements(summary: dict[str, Any], units: UnitSystem) -> Iterator[Row]:
    """Describe the kept and missed accuracy and promises, the measured damping, and the violated laws."""
    from carom.runs.outcome import accuracy_text, judged_promise

    if summary["accuracy"]:
        yield "accuracy", accuracy_text(summary["accuracy"], units)
    for name, verdict in summary["expect"].items():
        yield "promise", f"{name} {judged_promise(verdict)}"
    forces = summary.get("forces", {})
    second, metre = units.shown(1.0, TIME), units.shown(1.0, LENGTH)
    for name, what, length in (("damping", "speed", metre), ("angular_damping", "spin", 1.0)):
        if law := forces.get(name):
            more = f" + {law['by_speed'] / length:.3g} × {what}" if law["by_speed"] else ""
            rate = f"{law['rate'] / second:.3g}{more}"
            yield "damping", f"free bodies lose {what} at one common rate, {rate}; laws are judged beyond it"
    for law, broken in summary.get("laws", {}).items():
        first = f"first at step {broken['step']}, t = {units.text(broken['time'], TIME)}"
        yield "law broken", f"{law.replace('-', ' ')}, {first}; in {counted(broken['frames'], 'frame')}"


def _moments(summary: dict[str, Any], file: Path, units: UnitSystem) -> Iterator[str]:
    """List each extreme, with the commands that show it."""
    from carom.runs.outcome import moments

    first, last = summary.get("clip", {}).get("from", 0.0), summary["sim_time"]
    window = min(AROUND / max(1, summary["frames"] - 1), 1.0) * (last - first)
    for moment in moments(summary, units):
        span = (max(first, moment.time - window / 2), min(last, moment.time + window / 2))
        at, begin, end, length = (units.shown(time, TIME) for time in (moment.time, *span, window))
        yield f"{moment.text}, in step {moment.step}, to t = {units.text(moment.time, TIME)}"
        when = ("--event", moment.name) if moment.name == "impact" else ("--at", f"{at:.9g}")
        yield "    " + command("view", file, *when)  # the time of the impact may be within the step
        yield "    " + command("clip", file, "--around", f"{at:.9g}", "--window", f"{length:.3g}")
        if summary["scene"].get("engine") or summary.get("clip", {}).get("partial"):
            continue
        yield "    " + command("replay", file, "--from", f"{begin:.6g}", "--to", f"{end:.6g}", "--every", "step")


def _profile(profile: dict[str, float]) -> ShownTable:
    """Show the computing time by part of a step."""
    whole = sum(profile.values())
    columns = (
        ShownColumn("time of the steps", lambda row: f"  {row[0]}", left=True),
        ShownColumn(f"{whole:.3f} s", lambda row: f"{row[1]:.3f} s"),
        ShownColumn("", lambda row: f"{row[1] / whole:.0%}" if whole else ""),
    )
    return ShownTable(columns, sorted(profile.items(), key=lambda item: -item[1]))
