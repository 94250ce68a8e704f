"""`carom diff`: where and how two recordings differ."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from math import degrees
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from carom.scene.units.dimension import ENERGY, FORCE, IMPULSE, LENGTH, TIME, VELOCITY
from carom.scene.wording import bodies_called, command, counted
from carom.terminal.answers import CommandAnswer, Part, ShownColumn, ShownFacts, ShownTable, Strong
from carom.terminal.given_moment import EventOption, GivenMoment, StepOption, at_option
from carom.terminal.options import ForceOption, JsonOption, OptionalTime, not_a_folder, recording_option

if TYPE_CHECKING:
    from carom.lab.diff.diff import Diff, ImpactDivergence, ImpactPair, MomentApart
    from carom.lab.diff.divergence import FirstBits
    from carom.scene.units.system import UnitSystem
    from carom.scene.wording import Names

ROWS = 12  # number of rows in the table of the growing difference
KEYS = 50  # largest number of differing scene keys that are printed; --json has all
TURNED = 1e-3  # rad, smallest angle between two forces that is printed
LONGEST_VALUE = 60  # largest number of characters of a printed value; two values fit into a row of a wide terminal

_FIRST = "A recording (.rrd), or the zip of `carom report`."


def diff_command(
    a: Annotated[Path, typer.Argument(metavar="A", help=_FIRST, callback=not_a_folder)],
    b: Annotated[Path, typer.Argument(metavar="B", help="Another one.", callback=not_a_folder)],
    at: Annotated[OptionalTime, at_option("none; all common frames are compared")] = None,
    step: StepOption = None,
    event: EventOption = None,
    output: Annotated[Path | None, recording_option("Write both recordings into one .rrd for the viewer.")] = None,
    force: ForceOption = False,
    as_json: JsonOption = False,
) -> None:
    """Compare two recordings: where they differ first, and whether chaos explains it. Exit with 1 if they differ.

    Impacts of the same two bodies are compared in order of time. With a moment of A, the bodies that are farthest apart
    at that moment are listed, too.
    """
    from dataclasses import replace

    from carom.lab.diff.diff import diff as compare
    from carom.lab.diff.diff import overlay
    from carom.recording.edit.bundle import opened
    from carom.recording.read.lookup import names_of
    from carom.recording.read.recording import Recording
    from carom.recording.write.whole_file import refuse_itself, refuse_output
    from carom.terminal.console import replaying

    given = GivenMoment(at, step, event)
    if output is not None:
        for path in (a, b):
            refuse_itself(output, path)
        refuse_output(output, force)
    with opened(a) as one, opened(b) as other:
        recordings = Recording.open(one), Recording.open(other)
        with replaying(recordings[0]) as watch:
            moment = given.end(recordings[0], watch)
        found = replace(compare(*recordings, moment), paths=(a, b))
        if output is not None:
            overlay(*recordings, found, output)
        names = names_of(max(recordings, key=lambda recording: len(recording.bodies.name)))
        units = recordings[0].units
        CommandAnswer(_document(found, names, units), _parts(found, names, units, output)).say(as_json)
    if not found.same:
        raise typer.Exit(1)


def _document(found: Diff, names: Names, units: UnitSystem) -> dict[str, Any]:
    from dataclasses import asdict

    curve, verdict, bits = found.curve, found.verdict, None
    first = verdict.first
    keys = ("step", "time", "rms", "floor", "energy")
    rows = zip(*(getattr(curve, key).tolist() for key in keys), strict=True)
    if (state := found.first_bits) is not None:
        contact = state.contact and asdict(state.contact) | {"between": names.pair(state.contact.ends)}
        bits = asdict(state) | {"names": [names.of(body) for body in state.bodies], "contact": contact}
    return {
        "a": str(found.paths[0]),
        "b": str(found.paths[1]),
        "units": units.recorded,
        "same_bits": found.same,
        "verdict": {"kind": verdict.kind, "text": verdict.text, "jump": verdict.jump, "allowed": verdict.allowed},
        "scene": {key: list(values) for key, values in found.scene.items()},
        "defaults": {key: found.defaults[key] for key in found.scene if key in found.defaults},
        "environment": {key: list(values) for key, values in found.environment.items()},
        "frames": {
            "a": found.frames[0],
            "b": found.frames[1],
            "common": len(curve.step),
            "matched_by": found.matched_by,
        },
        "engines": list(found.engines),
        "first_difference": None if first is None else {"step": int(curve.step[first]), "time": curve.time[first]},
        "first_bits": bits,
        **({} if found.moment is None else {"moment": asdict(found.moment)}),
        "impacts": None if found.impacts is None else _impacts_document(found.impacts, names),
        **({"lives": [asdict(life) for life in found.lives]} if found.lives else {}),
        "growth": None if found.divergence is None else asdict(found.divergence),
        "size": curve.size,
        "curve": [dict(zip(keys, row, strict=True)) for row in rows],
    }


def _impacts_document(found: ImpactDivergence, names: Names) -> dict[str, Any]:
    from dataclasses import asdict

    def both(pair: ImpactPair | None) -> dict[str, Any] | None:
        if pair is None:
            return None
        impacts = {"a": pair.a, "b": pair.b}
        return {run: each and asdict(each) | {"between": names.pair(each.bodies)} for run, each in impacts.items()}

    return {
        "counts": None if found.counts is None else list(found.counts),
        "compared": found.compared,
        "first_difference": both(found.first),
        "first_in_one_only": both(found.alone),
    }


def _parts(found: Diff, names: Names, units: UnitSystem, output: Path | None) -> Iterator[Part]:
    yield ShownFacts(
        (
            ("A", f"{found.paths[0]}, {counted(found.frames[0], 'frame')}"),
            ("B", f"{found.paths[1]}, {counted(found.frames[1], 'frame')}"),
            ("scene", _scene_lines(found)),
            ("environment", _key_lines(found.environment, {})),
            ("in common", f"{counted(len(found.curve.step), 'frame')}, matched by {found.matched_by}"),
            ("moment", () if found.moment is None else _moment_lines(found.moment, names, units)),
            ("first bits", () if found.first_bits is None else _bits_lines(found.first_bits, names, units)),
            ("impacts", _impact_lines(found.impacts, names, units)),
            ("bodies", _first_lines([life.text(units) for life in found.lives], "")),
        )
    )
    yield ""
    if not found.same:
        yield _curve(found, units)
        yield ""
    yield Strong(f"{found.verdict.text[0].upper()}{found.verdict.text[1:]}.")
    if output is not None:
        yield f"{output} written, with both recordings overlaid; {command('view', output)}"


def _scene_lines(found: Diff) -> Iterator[str]:
    if any(found.engines):
        recorded = zip("AB", found.engines, strict=True)
        known = [f"{which} was recorded from {engine}" for which, engine in recorded if engine]
        yield f"not compared: {', '.join(known)}"
    if found.scene or not any(found.engines):
        yield from _key_lines(found.scene, found.defaults)


def _key_lines(differing: Mapping[str, tuple[Any, Any]], defaults: Mapping[str, Any]) -> list[str]:
    """Describe the values of keys in A and B."""
    values = {key: [_short(value, defaults.get(key)) for value in both] for key, both in differing.items()}
    return _first_lines([f"{key}: {a} in A, {b} in B" for key, (a, b) in values.items()], " keys") or ["the same"]


def _first_lines(lines: list[str], noun: str) -> list[str]:
    return lines[:KEYS] + ([f"… and {len(lines) - KEYS} more{noun}"] if len(lines) > KEYS else [])


def _bits_lines(found: FirstBits, names: Names, units: UnitSystem) -> Iterator[str]:
    """Describe the first bodies whose bits differ, their contact, and the laws broken in that step."""
    who, when = bodies_called(found.bodies, names.bodies), units.text(found.time, TIME, ".9g")
    yield f"step {found.step}, t = {when}: {', '.join(found.arrays)} of {who}"
    if found.contact is not None:
        contact = found.contact
        parts = [_both("normal force", contact.forces, units), _both("friction", contact.friction, units)]
        if contact.turned > TURNED:
            parts[1] += f", {degrees(contact.turned):.3g}° apart"
        yield f"contact of {names.pair(contact.ends)}: {'; '.join(filter(None, parts))}"
    yield from found.laws


def _both(what: str, forces: tuple[float | None, float | None], units: UnitSystem) -> str:
    """Describe a force (N) in both runs; empty if neither run has friction."""
    one, other = ("none" if force is None else units.text(force, FORCE, ".9g") for force in forces)
    if what == "friction" and not any(forces):
        return ""
    return f"{what} {one} in both" if one == other else f"{what} {one} in A, {other} in B"


def _moment_lines(found: MomentApart, names: Names, units: UnitSystem) -> Iterator[str]:
    """Describe the difference at a moment."""
    rms, energy = units.text(found.rms, LENGTH, ".2e"), units.text(found.energy, ENERGY, "+.2e")
    yield f"step {found.step}, t = {units.text(found.time, TIME, '.9g')}: {rms} apart (rms), energy {energy} (B - A)"
    for body, apart in zip(found.bodies, found.apart, strict=True):
        yield f"{names.of(body)}: {units.text(apart, LENGTH, '.2e')} apart"


def _impact_lines(found: ImpactDivergence | None, names: Names, units: UnitSystem) -> Iterator[str]:
    """Describe where the impacts differ, and by how much."""
    if found is None:
        yield "not compared, not recorded in both"
        return
    if found.counts is not None:
        yield f"{found.counts[0]} in A, {found.counts[1]} in B, up to the same time"
    if found.first is None:
        yield f"all {found.compared} recorded in both files are the same" if found.compared else "none recorded in both"
    different = [pair for pair in (found.first, found.alone) if pair is not None]
    for pair in sorted(different, key=lambda pair: pair.time):
        yield _called(pair, names, units)


def _called(pair: ImpactPair, names: Names, units: UnitSystem) -> str:
    """Describe an impact: its numbers in both runs, and the differences B - A of its data."""
    a, b = pair.a, pair.b
    one = a or b
    assert one is not None, "only one has it"
    what = f"{names.pair(one.bodies)}, t = {units.text(one.time, TIME, '.9g')}"
    if a is None or b is None:
        return f"first in {'B' if a is None else 'A'} only: impact {one.number}, {what}"
    differences = (
        (b.time - a.time, TIME, "time"),
        (b.approach_speed - a.approach_speed, VELOCITY, "approach speed"),
        (b.normal_impulse - a.normal_impulse, IMPULSE, "impulse"),
    )
    parts = [f"{units.text(value, dimension, '+.2e')} in {what}" for value, dimension, what in differences if value]
    parts += [f"{a.mode} in A, {b.mode} in B"] if a.mode != b.mode else []
    number = f"{a.number}" if a.number == b.number else f"{a.number} in A, {b.number} in B"
    by = f"{', '.join(parts)} (B - A)" if parts else "in direction, friction or energy loss"
    return f"first different: impact {number}, {what}: {by}"


def _curve(found: Diff, units: UnitSystem) -> ShownTable:
    """Show some frames from the first difference on."""
    import numpy as np

    curve, first = found.curve, found.verdict.first or 0

    def apart(k: int) -> float | str:
        rms, floor = curve.rms[k], curve.floor[k]
        limit = max(floor, rms)
        below = f"below {units.shown(limit, LENGTH):.0e}" if limit else "0"
        return rms if rms > floor else below

    columns = (
        ShownColumn("step", lambda k: curve.step[k]),
        ShownColumn("t", lambda k: curve.time[k], TIME, ".9g"),
        ShownColumn("rms distance", apart, LENGTH, ".2e"),
        ShownColumn("energy, B - A", lambda k: curve.energy[k], ENERGY, "+.2e"),
    )
    return ShownTable(columns, np.unique(np.linspace(first, len(curve.step) - 1, ROWS).astype(int)), units)


def _short(value: Any, default: Any = None) -> str:
    text = str(value)
    if value is None:
        text = "nothing" if default is None else f"{default} by default"
    return text if len(text) <= LONGEST_VALUE else text[: LONGEST_VALUE - 3] + "…"
