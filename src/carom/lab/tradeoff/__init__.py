"""`carom tradeoff`: the measured cost of accuracy in a scene; `carom tune`: the cheapest setting within limits."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterator, Mapping
from functools import partial
from pathlib import Path
from textwrap import fill
from typing import TYPE_CHECKING, Annotated

import typer

from carom.scene.units.dimension import TIME
from carom.scene.wording import command
from carom.terminal.answers import CommandAnswer, Part, ShownColumn, ShownTable, Strong
from carom.terminal.options import SceneArgument, SetOption, ThreadsOption
from carom.terminal.printing import say

if TYPE_CHECKING:
    from carom.lab.compared_run import Setting
    from carom.lab.tradeoff.reference import Teller
    from carom.lab.tradeoff.settings_grid import SettingResult
    from carom.lab.tradeoff.tradeoff import Study
    from carom.lab.tradeoff.tune import Tuning

VaryOption = Annotated[
    list[str] | None,
    typer.Option(
        "--vary",
        metavar="KEY=A,B,C",
        help="Values of a scene key (list or range, as for `carom sweep`), of `step` (a factor on the step) or of "
        "`threads`. Repeat it for combinations. Default: about a dozen settings that matter for the scene.",
    ),
]
RepeatsOption = Annotated[
    int | None,
    typer.Option(
        "--repeats",
        metavar="N",
        help="Time each setting N times. Default: three times where the front is uncertain, and runs below 50 ms until "
        "their time is known to 5 %.",
        min=1,
    ),
]
BudgetOption = Annotated[
    float | None,
    typer.Option(
        "--budget",
        metavar="SECONDS",
        help="Time that the measurements may take, in seconds; settings that are left out are named. Default: 30 times "
        "that of the scene as written, at least 5 s.",
        min=0.0,
    ),
]
EngineOption = Annotated[
    list[str] | None,
    typer.Option(
        "--engine",
        metavar="A,B,C",
        help="Compare with other engines on the same scene: rebound, mujoco, box3d, pybullet, newton. Needs their "
        "packages.",
    ),
]
LimitOption = Annotated[
    float | None,
    typer.Option(
        "--limit",
        metavar="SECONDS",
        help="Limit of the CPU time of each run, and of the time of a reference, in seconds. Default: none; settings "
        "not chosen with --vary stop after about 10⁶ steps.",
        min=0.0,
    ),
]
SHOWN = (  # errors in the table
    *("position", "velocity", "impact", "missed", "energy", "energy_gain", "momentum", "overlap", "sinking", "impacts"),
    *("size", "dispersion", "height", "density", "coordination", "settled_energy", "rest_time"),
)
IN_SECONDS = ("impact", "rest_time")  # errors with a unit of time
TO_THE_HORIZON = (  # errors that are compared only up to the horizon, while the reference is certain
    *(f"{error}{ending}" for error in ("position", "velocity") for ending in ("", "_max", "_end")),
    *("impact", "missed"),
)
STATISTICS = tuple(  # errors that are compared to the end of the reference
    f"{error}{ending}" for error in ("size", "dispersion") for ending in ("", "_max", "_end")
)
VAGUE = 0.5  # smallest relative uncertainty at which the uncertainty of a cost is shown as a factor
SPENT = "the budget"  # first words of the reason for settings that are left out when the budget is spent
STOPPED = "carom: stopped; the measurements are kept, and the same command continues"
COSTS = "cost / s", "known to", "steps", "mean step / written"  # columns of the first table
UNBROKEN_SLASH = "\N{NO-BREAK SPACE}/\N{NO-BREAK SPACE}"  # before a unit
HEADING = 10  # characters of a line in a heading: about as many as in a value
MARKS = {"front": "●", "near": "?"}  # marks beside an error in the table; see `_legend`
ADVICE = "start over with --new-study, or choose another folder with --study"


def tradeoff_command(
    scene: SceneArgument,
    vary: VaryOption = None,
    engines: EngineOption = None,
    repeats: RepeatsOption = None,
    budget: BudgetOption = None,
    limit: LimitOption = None,
    folder: Annotated[
        Path | None,
        typer.Option("-o", "--output", metavar="DIR", help="Folder of the study. Default: recordings/tradeoff/SCENE."),
    ] = None,
    overrides: SetOption = None,
    threads: ThreadsOption = None,
    force: Annotated[bool, typer.Option("-f", "--force", help="Start over and replace the existing study.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Measure cost and errors of a scene's settings, and show the settings that no other setting beats.

    Measurements are kept; the same command continues where it stopped.
    """
    from carom import registry
    from carom.lab.tradeoff.settings_grid import default_settings

    others = registry.imported("carom.engines.engine:engines_called")(engines) if engines else ()  # optional
    study, settings = opened(scene, vary, folder, overrides, threads, force, limit, budget)
    wanted = default_settings(study.scene) if settings is None else settings
    wanted += [setting for engine in others for setting in engine.settings(study.scene)]
    chooses = settings is None
    finished = ran(lambda tell: study.measure(wanted, repeats, tell, chooses=chooses), quiet=as_json)
    CommandAnswer(study.document(), _parts(study)).say(as_json)
    _draw(study, quiet=as_json)
    if not finished:
        say(STOPPED, err=True)
        raise typer.Exit(1)


def opened(
    source: str,
    vary: list[str] | None,
    folder: Path | None,
    overrides: list[str] | None,
    threads: int | None,
    anew: bool,
    limit: float | None,
    budget: float | None,
    advice: str | None = None,
) -> tuple[Study, list[Setting] | None]:
    """Open or begin the study of a scene; return it with the settings of ``--vary`` (None without that option)."""
    from carom.lab.tradeoff.settings_grid import vary as grid
    from carom.lab.tradeoff.tradeoff import ADVICE, Study
    from carom.scene.load import Scene

    scene = Scene.load(source, overrides)
    settings = grid(scene, vary) if vary else None
    study = Study(
        scene,
        folder or Path("recordings/tradeoff") / Path(source).stem,
        threads=threads,
        force=anew,
        advice=advice or ADVICE,
        limit=math.inf if limit is None else limit,
        bounded=settings is None,
        budget=budget,
    )
    return study, settings


def ran(measure: Callable[[Teller], object], *, quiet: bool) -> bool:
    """Measure, and print the progress; return False if the interrupt key stopped it."""
    from rich.markup import escape

    from carom.terminal.compilation import announce_compilation
    from carom.terminal.console import Terminal

    if not quiet:
        announce_compilation()
    console = Terminal(stderr=True, quiet=quiet, markup=True)
    try:
        if console.is_terminal:
            with console.status("") as status:
                measure(lambda text: status.update(escape(text)))
        else:
            measure(lambda text: console.print(escape(text), soft_wrap=True))
    except KeyboardInterrupt:
        return False
    return True


def _draw(study: Study, quiet: bool) -> None:
    """Write the table, the figure and the recording beside the document; print their paths, or why they are missing."""
    from carom.errors import ExperimentError
    from carom.lab.tradeoff.study_document import DOCUMENT
    from carom.lab.tradeoff.tradeoff import FIGURES, OVERLAY, TABLE
    from carom.lab.tradeoff.tradeoff_figure import draw, record, write_table

    if not any(result.complete for result in study.results):
        return
    document, recording = study.document(), study.folder / OVERLAY
    write_table(document, study.folder / TABLE)
    said = [str(study.folder / name) for name in (DOCUMENT, TABLE)]
    try:
        figures = [study.folder / name for name in FIGURES]
        draw(document, *figures, units=study.scene.unit_system)
        said += map(str, figures)
    except ExperimentError as error:
        said.append(f"no figure: {error}")
    record(study, recording)
    if not quiet:
        say("  ".join([*said, command("view", recording)]))


def _parts(study: Study) -> Iterator[Part]:
    from carom.lab.tradeoff.reference import phrase
    from carom.lab.tradeoff.settled_pile import Settled

    yield table_of(study)
    reference = study.reference
    if reference is None:
        return
    yield f"Reference, {reference.text}."
    end, horizon, units = study.scene.time.duration, reference.horizon, study.scene.unit_system
    yield (
        f"Positions are compared up to t = {units.text(horizon, TIME)} of {units.text(end, TIME)}. Until then, the "
        f"reference is certain to {study.floor('position'):.1e} of the size and {study.floor('velocity'):.1e} of the "
        "speed."
    )
    if reference.pile is not None:
        scatters = ", ".join(f"{phrase(each)} {study.floor(each):.1e}" for each in Settled._fields[:-1])
        yield (
            f"Settled piles of other seeds differ by {scatters}, and "
            f"{units.text(study.floor('rest_time'), TIME, '.2g')} in {phrase('rest_time')}; "
            "smaller differences are not errors."
        )
    yield _legend(study.noise)
    left_out = study.left_out
    for result in study.results:
        if result.reason and result.setting.name not in left_out:
            status = "" if result.status == "stopped" else f"{result.status}: "
            yield f"{result.setting.name}: {status}{result.reason}"
    yield from notes_on_rows(study)


def notes_on_rows(study: Study) -> Iterator[str]:
    """Name the settings that share a row of the table, and, by reason, the settings that were left out or not timed."""
    equal: dict[str, list[str]] = {}
    for result in study.results:
        if result.same_as:
            equal.setdefault(result.same_as, []).append(result.setting.name)
    for name, others in equal.items():
        yield f"The same run as {name}: {'; '.join(others)}."
    by_reason: dict[str, list[str]] = {}
    for name, reason in study.left_out.items():
        by_reason.setdefault(reason, []).append(name)
    for reason, names in by_reason.items():
        more = "; the same command continues" if reason.startswith(SPENT) else ""
        yield f"Left out, since {reason}: {'; '.join(names)}{more}."


def _legend(noise: float) -> str:
    if not noise:
        return (
            "● No other setting is as accurate and cheaper. Each was timed once, so the noise of the costs is unknown."
        )
    return (
        "● No other setting is as accurate and as cheap. ? Another setting may be, but the times or the reference are "
        "too uncertain. Without a mark: another setting is as accurate and cheaper. Costs are medians, known to half "
        f"their range, or to {noise:.0%} where that is more."
    )


def table_of(study: Study, errors: Collection[str] = SHOWN) -> ShownTable:
    """Make the table of a study, cheapest setting first, with columns for the costs and for each given error."""
    from carom.lab.compared_run import AS_WRITTEN
    from carom.lab.tradeoff.reference import NAMES

    measured = [r for r in study.results if r.errors is not None]
    done = sorted((r for r in measured if not r.same_as), key=lambda r: (math.isnan(r.cost), r.cost))
    failed = [r for r in study.results if r.errors is None and r.status != "left out"]
    written = next((r.steps for r in measured if r.setting == AS_WRITTEN), 0)
    shown = [e for e in NAMES if e in errors and any(not math.isnan(getattr(r.errors, e)) for r in done)]

    def cost(result: SettingResult) -> str:
        return result.status if result.errors is None else f"{result.cost:.3g}" if result.costs else ""

    def steps(result: SettingResult) -> str:
        return "" if result.errors is None and result.status != "stopped" else str(result.steps)

    def step(result: SettingResult) -> str:
        return f"{written / result.steps:.3g}" if result.errors and written and result.steps else ""

    def column(heading: str, value: Callable[[SettingResult], str]) -> ShownColumn:
        in_lines = fill(heading.replace(" / ", UNBROKEN_SLASH), HEADING, break_long_words=False)
        return ShownColumn(in_lines, value)

    columns = [ShownColumn("setting", lambda result: result.setting.name, left=True)]
    columns += map(column, COSTS, (cost, _certainty, steps, step))
    for error in shown:
        columns.append(column(_heading(study, error), partial(_cell, study, error, study.marks(error))))
    return ShownTable(columns, [*done, *failed], keys=1)


def _certainty(result: SettingResult) -> str:
    """Say how well a cost is known; empty for a single timing."""
    if len(result.costs) < 2:
        return ""
    return f"{result.spread:.0%}" if result.spread < VAGUE else f"a factor {1.0 + result.spread:.2g}"


def _heading(study: Study, error: str) -> str:
    """Return the heading of a column, with its unit and the time up to which positions are compared."""
    from carom.lab.tradeoff.reference import phrase

    units, reference = study.scene.unit_system, study.reference
    unit = units.unit(TIME) if error in IN_SECONDS else ""
    heading = f"{phrase(error)} / {unit}" if unit else phrase(error)
    if reference is not None and not reference.is_complete and error in TO_THE_HORIZON:
        heading += f" up to {units.text(reference.horizon, TIME)}"
    if reference is not None and not reference.whole and error in STATISTICS:
        heading += f" up to {units.text(float(reference.trajectory.time[-1]), TIME)}"
    return heading


def _cell(study: Study, error: str, marks: Mapping[str, str], result: SettingResult) -> str:
    if result.errors is None or math.isnan(value := getattr(result.errors, error)):
        return ""
    value = study.scene.unit_system.shown(value, TIME) if error in IN_SECONDS else value
    text = f"{value:.0f}" if error == "missed" else f"{value:.1e}" if value else "0"
    mark = marks.get(result.setting.name, "")
    text += f" {MARKS.get(mark, ' ')}"
    return Strong(text) if mark == "front" else text


def tune_command(
    scene: SceneArgument,
    error: Annotated[
        list[str] | None,
        typer.Option(
            "--error",
            metavar="NAME=LIMIT[:MEASURE]",
            help="Limit of an error, such as energy=1e-4; at least one. Repeatable. An error over time is measured as "
            "its rms, its maximum or at the end: position=1e-3:rms (the default), :max or :end.",
        ),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", metavar="FILE", help="Scene file to write. Default: SCENE-tuned.toml."),
    ] = None,
    vary: Annotated[
        list[str] | None,
        typer.Option(
            "--vary",
            metavar="KEY=A,B,C",
            help="Measure only these values and their combinations, in the form of `carom tradeoff`. Default: search "
            "for the cheapest setting, the step and one key after the other.",
        ),
    ] = None,
    repeats: RepeatsOption = None,
    budget: BudgetOption = None,
    limit: LimitOption = None,
    folder: Annotated[
        Path | None,
        typer.Option("--study", metavar="DIR", help="Folder of the measurements, shared with `carom tradeoff`."),
    ] = None,
    overrides: SetOption = None,
    threads: ThreadsOption = None,
    force: Annotated[bool, typer.Option("-f", "--force", help="Replace an existing FILE; keep the study.")] = False,
    new_study: Annotated[
        bool, typer.Option("--new-study", help="Measure everything again and replace the existing study.")
    ] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Find the cheapest setting that keeps every error limit, and write it as a scene file.

    The search starts from about a dozen settings. Then it changes the step, and one other key at a time, until nothing
    improves. Settings whose recording would have fewer frames are left out. Measurements are kept; the same command
    continues where it stopped.
    """
    from carom.lab.tradeoff.tune import limits, stopped, tuned, write
    from carom.recording.write.whole_file import refuse_scene_output

    asked = limits(error or [])
    path = output or Path(f"{Path(scene).stem}-tuned.toml")
    refuse_scene_output(path, scene, force)
    study, settings = opened(scene, vary, folder, overrides, threads, new_study, limit, budget, ADVICE)
    found: list[Tuning] = []
    finished = ran(lambda tell: found.append(tuned(study, asked, repeats, tell, settings)), quiet=as_json)
    table = table_of(study, asked)
    if not finished:
        CommandAnswer(stopped(study, asked), [table]).say(as_json)
        say(STOPPED, err=True)
        raise typer.Exit(1)
    (tuning,) = found
    lines = [*notes_on_rows(study)]
    if tuning.best is not None:
        write(tuning, path)
        lines += [*_tuning_lines(tuning), f"Written to {path}. The measurements stay in {study.folder}."]
    document = tuning.document() | {"file": str(path) if tuning.best else None}
    CommandAnswer(document, [table, *lines]).say(as_json)
    if tuning.best is None:
        said = f"none of the {len(tuning.tried)} settings tried keeps {', '.join(error or [])}: {tuning.why_none()}"
        say(f"carom: {said}", err=True)
        raise typer.Exit(1)


def _extent(tuning: Tuning, errors: Collection[str]) -> str:
    """Say up to which time errors are compared with the reference; empty if it is the end of the scene."""
    reference, units = tuning.study.reference, tuning.study.scene.unit_system
    compared = {*TO_THE_HORIZON, *(() if reference is None or reference.whole else STATISTICS)}
    if reference is None or reference.is_complete or not compared & set(errors):
        return ""
    return f" (compared with the reference up to t = {units.text(reference.horizon, TIME)} only)"


def _tuning_lines(tuning: Tuning) -> list[str]:
    """Describe the best settings: their speed relative to the scene as written, and the errors that they increase."""
    from carom.lab.tradeoff.reference import phrase

    best, written = tuning.best, tuning.written
    assert best is not None and best.errors is not None, "something was found"
    lines = [f"The cheapest of {len(tuning.tried)} settings tried: {best.setting.name}, {best.cost:.3g} s."]
    if written.costs and best is not written:
        missed = tuning.misses(written)
        but = f" and misses {', '.join(missed)}" if missed else ""
        lines.append(f"It is {tuning.claim}, which takes {written.cost:.3g} s{but}.")
    lines.append(f"It keeps {', '.join(tuning.kept(best))}{_extent(tuning, tuning.limits)}.")
    changes = tuning.worse()
    worse = [f"{phrase(name)} {after:.2g} (was {before:.2g})" for name, (before, after) in changes.items()]
    if worse:
        lines.append(f"Worse than the original scene: {', '.join(worse)}{_extent(tuning, changes)}.")
    if (passed := tuning.passed_over) is not None:
        frames = f"a recording would have {', '.join(tuning.misses(passed))}"
        lines.append(f"Cheaper, but rejected: {passed.setting.name}, {passed.cost:.3g} s; {frames}.")
    return lines
