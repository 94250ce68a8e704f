"""`carom crosscheck`: the same scene in other engines, and who is right."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from carom.cli.options import SceneArgument, SetOption, ThreadsOption
from carom.cli.text import say
from carom.cli.tradeoff import PIPE_WIDTH, STOPPED, ran
from carom.scene.command import command

if TYPE_CHECKING:
    from rich.table import Table

    from carom.experiment.crosscheck import Crosscheck


def crosscheck(
    scene: SceneArgument,
    engines: Annotated[
        list[str],
        typer.Option(
            "--engine",
            metavar="A,B,C",
            help="Engines to compare with: rebound, mujoco, box3d, pybullet. Needs their packages.",
        ),
    ],
    repeats: Annotated[int, typer.Option("--repeats", metavar="N", help="Time each run N times.", min=1)] = 3,
    folder: Annotated[
        Path | None,
        typer.Option("-o", "--output", metavar="DIR", help="Folder. Default: recordings/crosscheck/SCENE."),
    ] = None,
    overrides: SetOption = None,
    threads: ThreadsOption = None,
    force: Annotated[bool, typer.Option("--force", help="Start over, in place of earlier results.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Run a scene in other engines: errors, cost, criteria, where each parts from the reference, and the broken law.

    Results are kept; the same command continues where it stopped.
    """
    import json

    from carom.experiment.crosscheck import Crosscheck
    from carom.experiment.engines.engine import engine_called
    from carom.scene.schema import Scene

    names = [name.strip() for part in engines for name in part.split(",") if name.strip()]
    chosen = [engine_called(name) for name in dict.fromkeys(names)]
    where = folder or Path("recordings/crosscheck") / Path(scene).stem
    check = Crosscheck(Scene.load(scene, overrides), chosen, where, threads, force)
    for reason in check.refused.values():
        say(f"carom: {reason}", err=True)
    finished = ran(lambda tell: check.run(repeats, tell), quiet=as_json)
    document = check.document()
    if as_json:
        say(json.dumps(document, indent=2, ensure_ascii=False))
    else:
        _show(document)
    _draw(check, quiet=as_json)
    if not finished:
        say(STOPPED, err=True)
        raise typer.Exit(1)


def _show(document: dict[str, Any]) -> None:
    from rich.markup import escape

    from carom.cli.terminal import Terminal

    console = Terminal(markup=True)
    if not console.is_terminal:
        console.width = PIPE_WIDTH
    console.print(_table(document))
    reference = document["reference"]
    if reference is not None:
        console.print(
            f"Reference, {escape(reference['text'])}; positions are compared up to t = {reference['horizon']:.6g} s. "
            "A run parts where it is farther from it than a hundredth of the size.",
            soft_wrap=True,
        )
    for engine, notes in document["notes"].items():
        if notes:
            console.print(f"{engine}: {escape('; '.join(notes))}.", soft_wrap=True)
    for run in document["runs"]:
        if run["reason"]:
            console.print(f"{escape(run['name'])}: {run['status']}: {escape(run['reason'])}", soft_wrap=True)
        for broken in run.get("laws", {}).values():
            times = "" if broken["frames"] == 1 else f" In {broken['frames']} frames."
            text = f"{run['name']}, step {broken['step']}, t = {broken['time']:.6g} s: {broken['text']}{times}"
            console.print(escape(text), soft_wrap=True)


def _table(document: dict[str, Any]) -> Table:
    from rich import box
    from rich.markup import escape
    from rich.table import Table

    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for heading in ("run", "cost / s", "±", "steps", "position", "overlap", "criteria", "parts from the reference at"):
        table.add_column(heading, justify="left" if heading in ("run", "parts from the reference at") else "right")
    table.add_column("laws broken there")
    for run in document["runs"]:
        errors = run["errors"] or {}
        cost = (f"{run['cost']:.3g}", f"{run['spread']:.0%}") if run["cost"] is not None else ("", "")
        numbers = [_number(errors.get(name)) for name in ("position", "overlap")]
        parting = run.get("parting")
        laws = "" if parting is None else ", ".join(parting["laws"]) or "none"
        cells = (run["name"], *cost, str(run["steps"]), *numbers, _criteria(run), _parting(run), laws)
        table.add_row(*(escape(cell) for cell in cells))
    return table


def _criteria(run: dict[str, Any]) -> str:
    """Say how many criteria were met, and which were not."""
    criteria = run.get("criteria") or []
    missed = [each["name"] for each in criteria if not each["met"]]
    if not criteria:
        return "none"
    return f"{len(criteria) - len(missed)} of {len(criteria)}" + (f", not {', '.join(missed)}" if missed else "")


def _parting(run: dict[str, Any]) -> str:
    if run["status"] != "measured" or "parting" not in run:
        return run["status"] if run["status"] != "measured" else ""
    parting = run["parting"]
    if parting is None:
        return "nowhere"
    if parting["impact"] == 0:
        return f"t = {parting['time']:.6g} s, before any impact"
    return f"impact {parting['impact']}, {parting['between']}, t = {parting['impact_time']:.6g} s"


def _number(value: float | None) -> str:
    return "" if value is None else f"{value:.1e}" if value else "0"


def _draw(check: Crosscheck, quiet: bool) -> None:
    """Leave the figure and the recording of all runs beside the document; say where they are."""
    from carom.experiment.crosscheck import DOCUMENT, FIGURE, OVERLAY
    from carom.experiment.crosscheck_figure import draw
    from carom.experiment.error import ExperimentError
    from carom.experiment.work_precision.overlay import record

    if not any(result.complete for result in check.results):
        return
    said = [str(check.folder / DOCUMENT)]
    try:
        draw(check, check.folder / FIGURE)
        said.append(str(check.folder / FIGURE))
    except ExperimentError as error:
        said.append(f"no figure: {error}")
    record(check.study, check.folder / OVERLAY)
    if not quiet:
        say("  ".join([*said, command("view", check.folder / OVERLAY)]))
