"""`carom crosscheck`: runs a scene in several engines, and judges which engines are right."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from carom.scene.units.dimension import TIME
from carom.scene.wording import command
from carom.terminal.options import JsonOption, SetOption, ThreadsOption, bundled, output_option
from carom.terminal.printing import say, say_json

if TYPE_CHECKING:
    from rich.table import Table

    from carom.engines.crosscheck.crosscheck import Crosscheck, Teller
    from carom.scene.load import Scene
    from carom.scene.units.system import UnitSystem
    from carom.terminal.console import Terminal


SEVERAL_LIMIT = 30.0  # s, of each run and reference, if there are several scenes
_SCENES = "Scene files (.toml) or bundled scenes; `extremes` and `crosscheck` select all scenes of that folder."
_ENGINES = "Engines to compare with, at least one: rebound, mujoco, box3d, pybullet, newton. Needs their packages."
_LIMIT = (
    "Limit of the CPU time of a run, and of the time of a reference, in seconds. Default: none for one scene, "
    f"{SEVERAL_LIMIT:g} for several."
)
_FOLDER = "Folder of the results, or the parent folder for several scenes. Default: recordings/crosscheck/SCENE."
_WORKERS = "Number of processes for the untimed runs. Default: one per core if there are many runs."


def crosscheck_command(
    scenes: Annotated[list[str], typer.Argument(metavar="SCENE...", help=_SCENES, autocompletion=bundled)],
    engines: Annotated[list[str] | None, typer.Option("--engine", metavar="A,B,C", help=_ENGINES)] = None,
    repeats: Annotated[int, typer.Option("--repeats", metavar="N", help="Time each run N times.", min=1)] = 3,
    limit: Annotated[float | None, typer.Option("--limit", metavar="SECONDS", help=_LIMIT, min=0.0)] = None,
    folder: Annotated[Path | None, output_option("DIR", _FOLDER)] = None,
    overrides: SetOption = None,
    threads: ThreadsOption = None,
    workers: Annotated[int | None, typer.Option("--workers", metavar="N", help=_WORKERS, min=1)] = None,
    force: Annotated[bool, typer.Option("-f", "--force", help="Start over and replace earlier results.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Run a scene in other engines: errors, cost, criteria, where each diverges from the reference, and the broken law.

    Results are kept; the same command continues where it stopped.
    """
    from carom.engines.crosscheck.crosscheck import Crosscheck, Runs
    from carom.engines.engine import engines_called
    from carom.errors import ExperimentError
    from carom.lab.tradeoff import STOPPED, ran
    from carom.scene.load import Scene
    from carom.scene.scene_file import bundled_folders

    chosen, known = engines_called(engines or [""]), bundled_folders()  # without an engine, the message lists them
    names = list(dict.fromkeys(name for source in scenes for name in known.get(source.rstrip("/"), [source])))
    several = len(names) > 1
    loaded = {name: Scene.load(name, overrides) for name in names}
    for engine in chosen:
        engine.ensure_installed()
    limit = (SEVERAL_LIMIT if several else math.inf) if limit is None else limit
    parent = folder or Path("recordings/crosscheck")
    checks: dict[str, Crosscheck] = {}
    refused: dict[str, str] = {}
    runs = Runs(workers)
    for name, scene in loaded.items():
        where = folder if folder and not several else parent / Path(name).stem
        try:
            checks[name] = Crosscheck(scene, chosen, where, threads, force, limit, runs)
        except ExperimentError as error:
            if not several:
                raise
            refused[name] = str(error)
    if not several:
        for reason in next(iter(checks.values())).refused.values():
            say(f"carom: {reason}", err=True)
    headings = {name: f"{k}/{len(loaded)}  {name}: " if several else "" for k, name in enumerate(loaded, start=1)}

    def measure(tell: Teller) -> None:
        with runs:
            for check in checks.values():
                check.announce()
            runs.begin()
            for name, check in checks.items():
                check.follow(lambda text: tell(headings[name] + text))  # noqa: B023
        for name, check in checks.items():
            check.time(repeats, lambda text: tell(headings[name] + text))  # noqa: B023

    finished = ran(measure, quiet=as_json)
    documents = {name: check.document() for name, check in checks.items() if check.results}
    for check in checks.values():
        _draw(check, quiet=as_json or several)
    if as_json:
        said = {"scenes": documents, "refused": refused} if several else next(iter(documents.values()), {})
        say_json(said)
    elif several:
        _show_several(documents, loaded, refused, parent)
    elif documents:
        name, document = next(iter(documents.items()))
        _show(document, loaded[name].unit_system, checks[name].folder)
    if not finished:
        say(STOPPED, err=True)
        raise typer.Exit(1)


def _show_several(
    documents: dict[str, dict[str, Any]], scenes: dict[str, Scene], refused: dict[str, str], folder: Path
) -> None:
    """Print one table of all scenes with their subjects, and the scenes that no engine can represent."""
    from rich import box
    from rich.table import Table

    console = _console()
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for heading in ("scene", "run", "cost / s", "criteria", "diverges from the reference at", "laws broken"):
        table.add_column(heading, justify="right" if heading == "cost / s" else "left")
    for name, document in documents.items():
        for number, run in enumerate(document["runs"]):
            cost = "" if run["cost"] is None else f"{run['cost']:.3g}"
            laws = ", ".join(run.get("laws", {})) or "none"
            parting = _parting(run, document["reference"], scenes[name].unit_system)
            cells = ("" if number else name, run["name"], cost, _criteria(run), parting, laws)
            table.add_row(*cells, end_section=run is document["runs"][-1])
    console.print(table)
    for name in documents:
        if link := re.match(r"# From (https://\S+)", scenes[name].toml):  # the bug report that the scene was made from
            console.print(f"{name}: {scenes[name].title} ({link[1]})", soft_wrap=True)
    for name, reason in refused.items():
        console.print(f"{name}: {reason}", soft_wrap=True)
    versions = dict.fromkeys(each for document in documents.values() for each in document["versions"].values())
    console.print(f"Versions: {', '.join(versions)}.", soft_wrap=True)
    count = sum(1 for document in documents.values() if document["runs"])
    without = f"{len(refused)} cannot be represented by any of the engines"
    console.print(f"{count} scenes; {without}. Figures and recordings: {folder}/SCENE.", soft_wrap=True)


def _console() -> Terminal:
    from carom.lab.tradeoff import PIPE_WIDTH
    from carom.terminal.console import Terminal

    return Terminal(piped=PIPE_WIDTH)


def _show(document: dict[str, Any], units: UnitSystem, folder: Path) -> None:
    from carom.engines.crosscheck.crosscheck import OWN

    console = _console()
    console.print(_table(document, units))
    reference = document["reference"]
    if reference is not None:
        console.print(
            f"Reference, {reference['text']}; positions are compared {_extent(reference, units)}. "
            "A run diverges when its distance from the reference exceeds a hundredth of the size.",
            soft_wrap=True,
        )
    partings = [run["parting"] for run in document["runs"] if run.get("parting")]
    if number := next((each["impact"] for each in partings if each["impact"]), None):
        where = command("view", folder / f"{OWN.name}.rrd", "--event", f"impact:{number}")
        console.print(f"The impacts listed are the first with different outcomes, numbered as in carom's run: {where}")
    console.print(f"Versions: {', '.join(document['versions'].values())}.", soft_wrap=True)
    for engine, notes in document["notes"].items():
        if notes:
            console.print(f"{engine}: {'; '.join(notes)}.", soft_wrap=True)
    for run in document["runs"]:
        if run["reason"]:
            console.print(f"{run['name']}: {run['status']}: {run['reason']}", soft_wrap=True)
        for broken in run.get("laws", {}).values():
            times = "" if broken["frames"] == 1 else f" In {broken['frames']} frames."
            at = units.text(broken["time"], TIME)
            text = f"{run['name']}, step {broken['step']}, t = {at}: {broken['text']}{times}"
            console.print(text, soft_wrap=True)


def _table(document: dict[str, Any], units: UnitSystem) -> Table:
    from rich import box
    from rich.table import Table

    table, reference = Table(box=box.SIMPLE_HEAD, pad_edge=False), document["reference"]
    compared = "" if reference is None or reference["complete"] else f" {_extent(reference, units)}"
    table.add_column("run")
    for heading in ("cost / s", "±", "steps", f"position{compared}", "overlap", "energy change", "criteria"):
        table.add_column(heading, justify="right")
    for heading in ("diverges from the reference at", "laws broken there"):
        table.add_column(heading)
    for run in document["runs"]:
        errors = run["errors"] or {}
        cost = (f"{run['cost']:.3g}", f"{run['spread']:.0%}") if run["cost"] is not None else ("", "")
        known = (errors.get(name) for name in ("position", "overlap"))
        numbers = ["" if value is None else f"{value:.1e}" if value else "0" for value in known]
        numbers.append(_energy(run.get("energy") or {}))
        parting = run.get("parting")
        laws = "" if parting is None else ", ".join(parting["laws"]) or "none"
        cells = (run["name"], *cost, str(run["steps"]), *numbers, _criteria(run), _parting(run, reference, units), laws)
        table.add_row(*cells)
    return table


def _criteria(run: dict[str, Any]) -> str:
    """Describe the number of met criteria, and the missed or unjudged ones."""
    criteria = run.get("criteria") or []
    if not criteria:
        return "none"
    judged = [each for each in criteria if each["judged"]]
    missed = [each["name"] for each in judged if not each["met"]]
    unknown = [each["name"] for each in criteria if not each["judged"]]
    words = [f"{len(judged) - len(missed)} of {len(judged)}"] if judged else []
    words += [f"not {', '.join(missed)}"] if missed else []
    words += [f"not judged: {', '.join(unknown)}"] if unknown else []
    return "; ".join(words)


def _extent(reference: dict[str, Any], units: UnitSystem) -> str:
    """Return the time up to which positions are compared, in words."""
    return f"up to t = {units.text(reference['horizon'], TIME)}"


def _parting(run: dict[str, Any], reference: dict[str, Any] | None, units: UnitSystem) -> str:
    """Describe where a run diverges from the reference; "nowhere" if it was compared up to the end of the scene."""
    if run["status"] != "measured" or "parting" not in run:
        return run["status"] if run["status"] != "measured" else ""
    parting = run["parting"]
    if parting is None:
        if reference is None or not reference["horizon"]:
            return "not compared"
        return "nowhere" if reference["complete"] else f"not compared after {units.text(reference['horizon'], TIME)}"
    if parting["impact"] == 0:
        return f"t = {units.text(parting['time'], TIME)}, before any impact"
    number = "" if parting["impact"] is None else f" {parting['impact']}"
    return f"impact{number}, {parting['between']}, t = {units.text(parting['impact_time'], TIME)}"


def _energy(energy: dict[str, float | None]) -> str:
    """Describe the change of the energy and, for another engine with contacts, the part that no contact explains."""
    change, other = energy.get("change"), energy.get("without_contact")
    if change is None:
        return ""
    text = f"{change:+.1e}" if change else "0"
    if not energy.get("in_contact"):
        return text
    return f"{text}, {other:+.1e} without contact" if other else f"{text}, all in contact"


def _draw(check: Crosscheck, quiet: bool) -> None:
    """Write the figure and the recording of all runs beside the document, and print their paths."""
    from carom.engines.crosscheck.crosscheck import DOCUMENT, FIGURE, OVERLAY
    from carom.engines.crosscheck.crosscheck_figure import draw
    from carom.errors import ExperimentError
    from carom.lab.tradeoff.tradeoff_figure import record

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
