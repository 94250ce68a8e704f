"""`carom diff`: where and how two recordings differ."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from carom.scene.units.dimension import ENERGY, FORCE, IMPULSE, LENGTH, TIME, VELOCITY
from carom.scene.wording import bodies_called, command, counted
from carom.terminal.given_moment import EventOption, GivenMoment, StepOption, at_option
from carom.terminal.options import ForceOption, JsonOption, OptionalTime, not_a_folder, recording_option
from carom.terminal.printing import say_json

if TYPE_CHECKING:
    from rich.table import Table

    from carom.lab.diff.diff import Diff, ImpactDivergence, ImpactPair, MomentApart
    from carom.lab.diff.divergence import FirstBits
    from carom.recording.read.recording import Recording
    from carom.scene.units.system import UnitSystem
    from carom.scene.wording import Names

ROWS = 12  # rows in the table of the growing difference
KEYS = 50  # different keys of the scene printed at most; --json has all
LONGEST_VALUE = 60  # characters of a value of such a key; two fit into a row of a wide terminal

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

    Impacts of the same bodies are compared in their order. A moment of A adds a list of the bodies that are farthest
    apart at that moment.
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
        if as_json:
            say_json(_document(found, names, recordings[0].units))
        else:
            _print(found, names, recordings, output)
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


def _print(found: Diff, names: Names, recordings: tuple[Recording, Recording], output: Path | None) -> None:
    from carom.terminal.console import Terminal

    console, units = Terminal(soft_wrap=True), recordings[0].units
    console.print(_overview(found, names, units))
    if not found.same:
        console.print()
        console.print(_curve(found, units))
    console.print()
    console.print(f"{found.verdict.text[0].upper()}{found.verdict.text[1:]}.", style="bold")
    if output is not None:
        console.print(f"{output} written, with both recordings overlaid; {command('view', output)}")


def _overview(found: Diff, names: Names, units: UnitSystem) -> Table:
    from rich.table import Table

    table = Table.grid(padding=(0, 2))
    table.add_row("A", f"{found.paths[0]}, {counted(found.frames[0], 'frame')}")
    table.add_row("B", f"{found.paths[1]}, {counted(found.frames[1], 'frame')}")
    for name, differing in (("scene", found.scene), ("environment", found.environment)):
        if name == "scene" and any(found.engines):
            recorded = zip("AB", found.engines, strict=True)
            known = [f"{which} was recorded from {engine}" for which, engine in recorded if engine]
            table.add_row(name, f"not compared: {', '.join(known)}")
        elif not differing:
            table.add_row(name, "the same")
        for k, (key, (one, other)) in enumerate(list(differing.items())[:KEYS]):
            default = found.defaults.get(key) if name == "scene" else None
            in_a, in_b = _short(one, default), _short(other, default)
            table.add_row("" if k else name, f"{key}: {in_a} in A, {in_b} in B")
        if len(differing) > KEYS:
            table.add_row("", f"… and {len(differing) - KEYS} more keys")
    table.add_row("in common", f"{counted(len(found.curve.step), 'frame')}, matched by {found.matched_by}")
    bits = () if found.first_bits is None else _bits_lines(found.first_bits, names, units)
    moment = () if found.moment is None else _moment_lines(found.moment, names, units)
    lives = [life.text(units) for life in found.lives[:KEYS]]
    lives += [f"… and {len(found.lives) - KEYS} more"] if len(found.lives) > KEYS else []
    impacts = _impact_lines(found.impacts, names, units)
    for name, lines in (("moment", moment), ("first bits", bits), ("impacts", impacts), ("bodies", lives)):
        for k, line in enumerate(lines):
            table.add_row("" if k else name, line)
    return table


def _bits_lines(found: FirstBits, names: Names, units: UnitSystem) -> Iterator[str]:
    """Describe the first bodies whose bits differ, their contact and the laws that were broken there."""
    who, when = bodies_called(found.bodies, names.bodies), units.text(found.time, TIME, ".9g")
    yield f"step {found.step}, t = {when}: {', '.join(found.arrays)} of {who}"
    if found.contact is not None:
        one, other = ("none" if force is None else units.text(force, FORCE, ".9g") for force in found.contact.forces)
        yield f"contact of {names.pair(found.contact.ends)}: normal force {one} in A, {other} in B"
    yield from found.laws


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
    """Describe an impact: its numbers in both runs, and the differences between them, B - A."""
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


def _curve(found: Diff, units: UnitSystem) -> Table:
    """Show some frames from the first difference on."""
    import numpy as np
    from rich.table import Table

    curve, first = found.curve, found.verdict.first or 0
    measured = (("t", TIME), ("rms distance", LENGTH), ("energy, B - A", ENERGY))
    table = Table("step", *(units.labelled(*each) for each in measured), box=None, pad_edge=False)
    for column in table.columns:
        column.justify = "right"
    chosen = np.unique(np.linspace(first, len(curve.step) - 1, ROWS).astype(int))
    for k in chosen:
        seen = curve.rms[k] > curve.floor[k]
        limit = max(curve.floor[k], curve.rms[k])
        rms = f"{units.shown(curve.rms[k], LENGTH):.2e}" if seen else f"below {units.shown(limit, LENGTH):.0e}"
        time, energy = units.shown(curve.time[k], TIME), units.shown(curve.energy[k], ENERGY)
        table.add_row(str(curve.step[k]), f"{time:.9g}", rms, f"{energy:+.2e}")
    return table


def _short(value: Any, default: Any = None) -> str:
    text = str(value)
    if value is None:
        text = "nothing" if default is None else f"{default} by default"
    return text if len(text) <= LONGEST_VALUE else text[: LONGEST_VALUE - 3] + "…"
