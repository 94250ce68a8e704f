"""`carom diff`: where and how two recordings part."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from carom.cli.options import ForceOption, JsonOption
from carom.cli.text import say
from carom.scene.command import command

if TYPE_CHECKING:
    from rich.table import Table

    from carom.experiment.diff.diff import Diff

ROWS = 12  # of the table of how the difference grows
KEYS = 50  # of the scene that are printed; --json has all

FirstArgument = Annotated[Path, typer.Argument(metavar="A", help="A recording (.rrd).")]
SecondArgument = Annotated[Path, typer.Argument(metavar="B", help="Another recording (.rrd).")]


def diff(
    a: FirstArgument,
    b: SecondArgument,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", metavar="BOTH", help="Write both into one .rrd for the viewer.")
    ] = None,
    force: ForceOption = False,
    as_json: JsonOption = False,
) -> None:
    """Compare two recordings: where they differ first, and whether chaos explains it. Exit with 1 if they differ."""
    import json

    from carom.experiment.diff.diff import diff as compare
    from carom.experiment.diff.diff import overlay
    from carom.experiment.output import refuse_output
    from carom.recording.errors import RecordingError
    from carom.recording.read.recording import Recording

    if output is not None:
        if any(output.exists() and path.exists() and output.samefile(path) for path in (a, b)):
            raise RecordingError(f"{output} is one of the two recordings; choose another file with -o")
        refuse_output(output, force)
    recordings = Recording.open(a), Recording.open(b)
    found = compare(*recordings)
    if output is not None:
        overlay(*recordings, found, output)
    if as_json:
        say(json.dumps(_document(found), indent=2, ensure_ascii=False))
    else:
        _print(found, output)
    if not found.same:
        raise typer.Exit(1)


def _document(found: Diff) -> dict[str, Any]:
    """Nest what was found as JSON has it: no NaN, no infinity."""
    from dataclasses import asdict
    from math import isfinite

    curve, verdict = found.curve, found.verdict
    first = verdict.first
    columns = zip(*(getattr(curve, name).tolist() for name in ("step", "time", "rms", "floor", "energy")), strict=True)
    names = ("step", "time", "rms", "floor", "energy")
    document: dict[str, Any] = {
        "a": str(found.paths[0]),
        "b": str(found.paths[1]),
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
        "first_difference": None if first is None else {"step": int(curve.step[first]), "time": curve.time[first]},
        "growth": None if found.divergence is None else asdict(found.divergence),
        "size": curve.size,
        "curve": [dict(zip(names, row, strict=True)) for row in columns],
    }

    def finite(value: Any) -> Any:
        if isinstance(value, float) and not isfinite(value):
            return None
        if isinstance(value, dict):
            return {key: finite(inner) for key, inner in value.items()}
        return [finite(inner) for inner in value] if isinstance(value, list) else value

    return dict(finite(document))


def _print(found: Diff, output: Path | None) -> None:
    from carom.cli.terminal import Terminal

    console = Terminal(soft_wrap=True)
    console.print(_overview(found))
    if not found.same:
        console.print()
        console.print(_curve(found))
    console.print()
    console.print(f"{found.verdict.text[0].upper()}{found.verdict.text[1:]}.", style="bold")
    if output is not None:
        console.print(f"{output} written: both, one over the other; {command('view', output)}")


def _overview(found: Diff) -> Table:
    from rich.table import Table

    table = Table.grid(padding=(0, 2))
    table.add_row("A", f"{found.paths[0]}, {found.frames[0]} frames")
    table.add_row("B", f"{found.paths[1]}, {found.frames[1]} frames")
    for name, differing in (("scene", found.scene), ("environment", found.environment)):
        if not differing:
            table.add_row(name, "the same")
        for k, (key, (one, other)) in enumerate(list(differing.items())[:KEYS]):
            default = found.defaults.get(key) if name == "scene" else None
            in_a, in_b = _short(one, default), _short(other, default)
            table.add_row("" if k else name, f"{key}: {in_a} in A, {in_b} in B")
        if len(differing) > KEYS:
            table.add_row("", f"… and {len(differing) - KEYS} more keys")
    table.add_row("in common", f"{len(found.curve.step)} frames, matched by {found.matched_by}")
    return table


def _curve(found: Diff) -> Table:
    """Show a dozen frames from the first difference on."""
    import numpy as np
    from rich.table import Table

    curve, first = found.curve, found.verdict.first or 0
    table = Table("step", "t (s)", "rms distance (m)", "energy, B - A (J)", box=None, pad_edge=False)
    for column in table.columns:
        column.justify = "right"
    chosen = np.unique(np.linspace(first, len(curve.step) - 1, ROWS).astype(int))
    for k in chosen:
        seen = curve.rms[k] > curve.floor[k]
        rms = f"{curve.rms[k]:.2e}" if seen else f"below {max(curve.floor[k], curve.rms[k]):.0e}"
        table.add_row(str(curve.step[k]), f"{curve.time[k]:.6g}", rms, f"{curve.energy[k]:+.2e}")
    return table


def _short(value: Any, default: Any = None) -> str:
    text = str(value)
    if value is None:
        text = "nothing" if default is None else f"{default} by default"
    return text if len(text) <= 60 else text[:57] + "…"
