"""`carom inspect`: what is in a recording."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from carom.cli.options import RecordingArgument

if TYPE_CHECKING:
    from rich.table import Table

MOMENTS = {
    "impact": "hardest impact, {value:.4g} J",
    "overlap": "deepest overlap, {value:.3%} of the smaller radius",
    "contacts": "most contacts, {value:.0f}",
    "energy_error": "largest integration error, {value:.2e} of the energy scale",
}


def inspect(
    file: RecordingArgument,
    as_json: Annotated[bool, typer.Option("--json", help="Print as JSON.")] = False,
) -> None:
    """Say what is in a recording: outcome, energies, worst moments, where the time went, versions."""
    import json

    from carom.recording.recording import Recording

    summary = Recording.open(file).summary()
    if as_json:
        typer.echo(json.dumps(summary, indent=2, ensure_ascii=False))
        return
    from rich.console import Console

    console = Console(soft_wrap=True, highlight=False)
    for table in (_overview(summary), _moments(summary, file), _profile(summary)):
        if table.row_count:
            console.print(table)
            console.print()


def _grid() -> Table:
    from rich.table import Table

    return Table.grid(padding=(0, 2))


def _overview(summary: dict[str, Any]) -> Table:
    energy, contacts = summary["energy"], summary["contacts"]
    angular = summary["angular_momentum"]["max_error"]
    table = _grid()
    table.add_row("scene", f"{summary['scene']['title']}, {summary['bodies']} bodies")
    clip = summary.get("clip")
    if clip:
        few = "" if len(clip["bodies"]) == summary["bodies"] else f", bodies {' '.join(map(str, clip['bodies']))}"
        table.add_row("clip of", f"{clip['source']}, {clip['from']:.6g} to {clip['to']:.6g} s{few}")
    table.add_row("outcome", summary["outcome"] + (" (the whole run)" if clip else ""))
    steps = f"steps {clip['first_step']} to {summary['steps']}" if clip else f"{summary['steps']} steps"
    length = summary["sim_time"] - (clip["from"] if clip else 0.0)
    table.add_row("length", f"{summary['frames']} frames, {steps}, {length:.6g} s simulated")
    table.add_row("energy", f"{energy['initial']:.6g} J at first, {energy['final']:.6g} J at last")
    table.add_row("", f"integration error at most {energy['max_error']:.2e} of the energy scale")
    linear = summary["momentum"]["max_error"]
    table.add_row(
        "momentum", "not conserved: something fixed takes it" if linear is None else f"error at most {linear:.2e}"
    )
    unknown = "not conserved in a periodic box" if linear is not None else "likewise"
    table.add_row("angular momentum", unknown if angular is None else f"error at most {angular:.2e}")
    table.add_row(
        "contacts", f"{contacts['total']}, deepest overlap {contacts['max_overlap']:.3%} of the smaller radius"
    )
    for name, verdict in summary["expect"].items():
        kept = "kept" if verdict["met"] else "MISSED"
        bound = verdict.get("bound", "at most")  # recordings of before there was another bound
        table.add_row("promise", f"{name} {verdict['measured']:.3g}, {bound} {verdict['limit']:.3g}: {kept}")
    table.add_row("versions", ", ".join(f"{name} {version}" for name, version in summary["versions"].items()))
    return table


def _moments(summary: dict[str, Any], file: Path) -> Table:
    """Show each extreme with the command that looks at it."""
    table = _grid()
    for name, wording in MOMENTS.items():
        moment = summary["moments"].get(name)
        if moment:
            who = " and ".join(map(str, moment["bodies"]))
            what = wording.format(value=moment["value"]) + (f", bodies {who}" if who else "")
            table.add_row(what, f"step {moment['step']}", f"carom view {file} --at {moment['time']:.6g}")
    return table


def _profile(summary: dict[str, Any]) -> Table:
    """Show where the time of the steps went."""
    table, whole = _grid(), sum(summary["profile"].values())
    for part, seconds in sorted(summary["profile"].items(), key=lambda item: -item[1]):
        table.add_row(part, f"{seconds:.3f} s", f"{seconds / whole:.0%}" if whole else "")
    return table
