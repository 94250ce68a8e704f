"""`carom tune`: the cheapest setting of a scene that keeps its errors within limits."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from carom.extend import TIME, SceneArgument, SetOption, ThreadsOption, say, say_json
from carom.lab.tradeoff.tradeoff_command import (
    COLUMNS,
    PIPE_WIDTH,
    STATISTICS,
    STOPPED,
    TO_THE_HORIZON,
    LimitOption,
    RepeatsOption,
    opened,
    ran,
    table_of,
)

if TYPE_CHECKING:
    from carom.lab.tradeoff.tradeoff import Study
    from carom.lab.tradeoff.tune import Tuning

ADVICE = "start over with --new-study, or choose another folder with --study"


def tune(
    scene: SceneArgument,
    error: Annotated[
        list[str],
        typer.Option(
            "--error", metavar="NAME=LIMIT", help="Limit of an error, such as energy=1e-4 or position=1e-3. Repeatable."
        ),
    ],
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", metavar="FILE", help="Scene file to write. Default: SCENE-tuned.toml."),
    ] = None,
    vary: Annotated[
        list[str] | None,
        typer.Option(
            "--vary",
            metavar="KEY=A,B,C",
            help="Measure only these values and their combinations, as for `carom tradeoff`. Default: search for the "
            "cheapest setting, the step and one key after the other.",
        ),
    ] = None,
    repeats: RepeatsOption = 3,
    limit: LimitOption = None,
    folder: Annotated[
        Path | None,
        typer.Option("--study", metavar="DIR", help="Folder of the measurements, as for `carom tradeoff`."),
    ] = None,
    overrides: SetOption = None,
    threads: ThreadsOption = None,
    force: Annotated[bool, typer.Option("--force", help="Replace an existing FILE; keep the study.")] = False,
    new_study: Annotated[
        bool, typer.Option("--new-study", help="Measure everything again and replace the existing study.")
    ] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Find the cheapest setting that keeps every error limit, and write it as a scene file.

    The search starts from about a dozen settings. It then changes the step, and one key at a time, until nothing
    improves. It leaves out settings whose recording would have fewer frames. Measurements are kept; the same command
    continues where it stopped.
    """
    from carom.extend import refuse_scene_output
    from carom.lab.tradeoff.tune import limits, stopped, tuned, write

    asked = limits(error)
    path = output or Path(f"{Path(scene).stem}-tuned.toml")
    refuse_scene_output(path, scene, force)
    study, settings = opened(scene, vary, folder, overrides, threads, new_study, limit, ADVICE)
    found: list[Tuning] = []
    finished = ran(lambda tell: found.append(tuned(study, asked, repeats, tell, settings)), quiet=as_json)
    if not as_json:
        _show(study, asked)
    if not finished:
        if as_json:
            say_json(stopped(study, asked))
        say(STOPPED, err=True)
        raise typer.Exit(1)
    (tuning,) = found
    if tuning.best is not None:
        write(tuning, path)
    if as_json:
        document = tuning.document() | {"file": str(path) if tuning.best else None}
        say_json(document)
    elif tuning.best is not None:
        say("\n".join([*_lines(tuning), f"Written to {path}. The measurements stay in {study.folder}."]))
    if tuning.best is None:
        said = f"none of the {len(tuning.tried)} settings tried keeps {', '.join(error)}: {tuning.why_none()}"
        say(f"carom: {said}", err=True)
        raise typer.Exit(1)


def _show(study: Study, limits: Collection[str]) -> None:
    from carom.extend import Terminal

    console = Terminal(markup=True)
    if not console.is_terminal:
        console.width = PIPE_WIDTH
    console.print(table_of(study, limits))


def _extent(tuning: Tuning, errors: Collection[str]) -> str:
    """Return the time up to which errors are compared with the reference, if it is not the end of the scene."""
    reference, units = tuning.study.reference, tuning.study.scene.unit_system
    compared = {*TO_THE_HORIZON, *(() if reference is None or reference.whole else STATISTICS)}
    if reference is None or reference.is_complete or not compared & set(errors):
        return ""
    return f" (compared with the reference up to t = {units.text(reference.horizon, TIME)} only)"


def _lines(tuning: Tuning) -> list[str]:
    """Describe the best settings: their gain in speed over the scene as written, and what they make worse."""
    best, written = tuning.best, tuning.written
    assert best is not None and best.errors is not None, "something was found"
    lines = [f"The cheapest of {len(tuning.tried)} settings tried: {best.setting.name}, {best.cost:.3g} s."]
    if written.costs and best is not written:
        missed = tuning.misses(written)
        but = f", which misses {', '.join(missed)}" if missed else ""
        lines.append(f"It is {tuning.speed:.2g} times as fast as the original scene ({written.cost:.3g} s{but}).")
    kept = [f"{name} {getattr(best.errors, name):.2g} (limit {limit:.2g})" for name, limit in tuning.limits.items()]
    lines.append(f"It keeps {', '.join(kept)}{_extent(tuning, tuning.limits)}.")
    changes = tuning.worse()
    worse = [f"{COLUMNS.get(name, name)} {after:.2g} (was {before:.2g})" for name, (before, after) in changes.items()]
    if worse:
        lines.append(f"Worse than the original scene: {', '.join(worse)}{_extent(tuning, changes)}.")
    if (passed := tuning.passed_over) is not None:
        frames = f"a recording would have {', '.join(tuning.misses(passed))}"
        lines.append(f"Cheaper, but rejected: {passed.setting.name}, {passed.cost:.3g} s; {frames}.")
    return lines
