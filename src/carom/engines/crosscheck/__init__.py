"""`carom crosscheck`: runs a scene in several engines, and judges which engines are right."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from carom.scene.units.dimension import TIME
from carom.scene.wording import command
from carom.terminal.answers import CommandAnswer, Part, ShownColumn, ShownTable
from carom.terminal.options import JsonOption, SetOption, ThreadsOption, bundled, output_option
from carom.terminal.printing import say

if TYPE_CHECKING:
    from carom.engines.crosscheck.crosscheck import Crosscheck, Teller
    from carom.scene.load import Scene
    from carom.scene.units.system import UnitSystem


SEVERAL_LIMIT = 30.0  # s, time limit of each run and reference if there are several scenes
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
    """Run a scene in other engines: errors, cost, criteria, where each engine leaves the reference, the broken law.

    Results are kept; the same command continues where it stopped.
    """
    from carom.engines.crosscheck.crosscheck import Crosscheck, Runs
    from carom.engines.engine import engines_called
    from carom.errors import ExperimentError
    from carom.lab.tradeoff import STOPPED, ran
    from carom.scene.load import Scene
    from carom.scene.scene_file import bundled_folders

    chosen, known = engines_called(engines or [""]), bundled_folders()  # no name: the error lists the engines
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
    if several:
        answer = CommandAnswer(
            {"scenes": documents, "refused": refused}, _parts_of_several(documents, loaded, refused, parent)
        )
    else:
        (name,) = checks
        parts = _parts(documents[name], loaded[name].unit_system, checks[name].folder) if documents else ()
        answer = CommandAnswer(documents.get(name, {}), parts)
    answer.say(as_json)
    if not finished:
        say(STOPPED, err=True)
        raise typer.Exit(1)


def _parts_of_several(
    documents: dict[str, dict[str, Any]], scenes: dict[str, Scene], refused: dict[str, str], folder: Path
) -> Iterator[Part]:
    """Show one table of all scenes with their subjects, and the scenes that no engine can represent."""

    def parting(row: tuple[str, int, dict[str, Any]]) -> str:
        name, _, run = row
        return _parting(run, documents[name]["reference"], scenes[name].unit_system)

    columns = [
        ShownColumn("scene", lambda row: "" if row[1] else row[0], left=True),
        ShownColumn("run", lambda row: row[2]["name"], left=True),
        ShownColumn("cost / s", lambda row: _cost(row[2])),
        ShownColumn("criteria", lambda row: _criteria(row[2]), left=True),
        ShownColumn("diverges from the reference at", parting, left=True),
        ShownColumn("laws broken", lambda row: ", ".join(row[2].get("laws", {})) or "none", left=True),
    ]
    rows = [(name, k, run) for name, document in documents.items() for k, run in enumerate(document["runs"])]
    yield ShownTable(columns, rows, keys=2)
    for name in documents:
        if link := re.match(r"# From (https://\S+)", scenes[name].toml):  # the scene's text links to a bug report
            yield f"{name}: {scenes[name].title} ({link[1]})"
    for name, reason in refused.items():
        yield f"{name}: {reason}"
    versions = dict.fromkeys(each for document in documents.values() for each in document["versions"].values())
    yield f"Versions: {', '.join(versions)}."
    count = sum(1 for document in documents.values() if document["runs"])
    without = f"{len(refused)} cannot be represented by any of the engines"
    yield f"{count} scenes; {without}. Figures and recordings: {folder}/SCENE."


def _parts(document: dict[str, Any], units: UnitSystem, folder: Path) -> Iterator[Part]:
    from carom.engines.crosscheck.crosscheck import OWN

    reference = document["reference"]
    yield _table(document, units)
    if reference is not None:
        yield (
            f"Reference, {reference['text']}; positions are compared {_extent(reference, units)}. "
            "A run diverges when its distance from the reference exceeds a hundredth of the size."
        )
    partings = [run["parting"] for run in document["runs"] if run.get("parting")]
    if number := next((each["impact"] for each in partings if each["impact"]), None):
        where = command("view", folder / f"{OWN.name}.rrd", "--event", f"impact:{number}")
        yield f"The impacts listed are the first with different outcomes, numbered as in carom's run: {where}"
    yield f"Versions: {', '.join(document['versions'].values())}."
    for engine, notes in document["notes"].items():
        if notes:
            yield f"{engine}: {'; '.join(notes)}."
    for run in document["runs"]:
        if run["reason"]:
            yield f"{run['name']}: {run['status']}: {run['reason']}"
        for broken in run.get("laws", {}).values():
            times = "" if broken["frames"] == 1 else f" In {broken['frames']} frames."
            at = units.text(broken["time"], TIME)
            yield f"{run['name']}, step {broken['step']}, t = {at}: {broken['text']}{times}"


def _table(document: dict[str, Any], units: UnitSystem) -> ShownTable:
    reference = document["reference"]
    compared = "" if reference is None or reference["complete"] else f" {_extent(reference, units)}"

    def laws(run: dict[str, Any]) -> str:
        return "" if run.get("parting") is None else ", ".join(run["parting"]["laws"]) or "none"

    columns = [
        ShownColumn("run", lambda run: run["name"], left=True),
        ShownColumn("cost / s", _cost),
        ShownColumn("±", lambda run: None if run["cost"] is None else f"{run['spread']:.0%}"),
        ShownColumn("steps", lambda run: run["steps"]),
        ShownColumn(f"position{compared}", lambda run: _error(run, "position")),
        ShownColumn("overlap", lambda run: _error(run, "overlap")),
        ShownColumn("energy change", lambda run: _energy(run.get("energy") or {})),
        ShownColumn("criteria", _criteria),
        ShownColumn("diverges from the reference at", lambda run: _parting(run, reference, units), left=True),
        ShownColumn("laws broken there", laws, left=True),
    ]
    return ShownTable(columns, document["runs"], keys=1)


def _cost(run: dict[str, Any]) -> str:
    return "" if run["cost"] is None else f"{run['cost']:.3g}"


def _error(run: dict[str, Any], name: str) -> str:
    value = (run["errors"] or {}).get(name)
    return "" if value is None else f"{value:.1e}" if value else "0"


def _criteria(run: dict[str, Any]) -> str:
    """Describe the number of met criteria, and name the missed and the unjudged criteria."""
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
    """Describe where a run diverges from the reference; "nowhere" if it does not, up to the end of the scene."""
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
    """Describe the change of the energy; for another engine with contacts, also the part outside of contacts."""
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
