"""`carom fork`: continues from a moment of a recording, with other parameters or from a slightly different state."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from carom.scene.wording import command
from carom.terminal.answers import CommandAnswer, markdown
from carom.terminal.console import LiveLine, bar, replaying
from carom.terminal.given_moment import EventOption, GivenMoment, StepOption, at_option
from carom.terminal.options import (
    ForceOption,
    JsonOption,
    OptionalTime,
    RecordingArgument,
    SetOption,
    recording_option,
)

if TYPE_CHECKING:
    from collections.abc import Iterator

    from carom.lab.fork.branch import Branch, ForkStart
    from carom.lab.fork.fork import Ensemble, Inevitable

MOST_SEEDS, MOST_TIMES = 100_000, 1000
DEFAULT_TIMES = 8
_PERTURB = "Change every coordinate by some units in the last place, such as 1ulp."
_OUTCOME = (
    "Count the forks that satisfy this condition at their end, such as 'x_3 > 1'. Names: x_3, speed_3, or those of "
    "`carom inspect --json`."
)
_TIMES = (
    "Fork at N times from T on, to show how the probability of the --outcome depends on the time. Default: "
    f"{DEFAULT_TIMES}."
)
_WHEN = "Find the moment from which the --outcome was inevitable."


def fork_command(
    file: RecordingArgument,
    at: Annotated[OptionalTime, at_option("none; a fork needs a moment")] = None,
    step: StepOption = None,
    event: EventOption = None,
    overrides: SetOption = None,
    perturb: Annotated[str | None, typer.Option("--perturb", metavar="ULPS", help=_PERTURB)] = None,
    seeds: Annotated[
        int, typer.Option("--seeds", metavar="N", min=1, max=MOST_SEEDS, help="Number of perturbed forks.")
    ] = 1,
    outcome: Annotated[str | None, typer.Option("--outcome", metavar="CONDITION", help=_OUTCOME)] = None,
    times: Annotated[int | None, typer.Option("--times", metavar="N", min=1, max=MOST_TIMES, help=_TIMES)] = None,
    when: Annotated[bool, typer.Option("--inevitable", help=_WHEN)] = False,
    output: Annotated[Path | None, recording_option("File for the viewer. Default: FILE-fork.rrd.")] = None,
    force: ForceOption = False,
    as_json: JsonOption = False,
) -> None:
    """Continue from a moment of a recording, under other parameters or from a state that differs in the last bits.

    Only the steps after the moment are run. One file contains both runs and their difference; with --seeds, it contains
    the range that all forks span.
    """
    from carom.errors import ExperimentError
    from carom.lab.fork.branch import Branch, start_of
    from carom.recording.edit.bundle import opened
    from carom.recording.read.recording import Recording
    from carom.recording.write.whole_file import refuse_itself, refuse_output

    asked, ulps = GivenMoment(at, step, event), 0
    if asked.option is None:
        raise ExperimentError("a fork needs a moment: give --at T, --step N or --event NAME")
    if perturb is not None:
        match = re.fullmatch(r"\s*(\d{1,9})\s*(ulps?)?\s*", perturb)
        ulps = int(match[1]) if match else 0
        if ulps == 0:
            raise typer.BadParameter(f"{perturb}: expected a number of units in the last place, such as 1ulp")
    if overrides is None and perturb is None:
        raise ExperimentError("nothing to change: give --set KEY=VALUE or --perturb 1ulp")
    if perturb is None and (seeds > 1 or when):
        raise ExperimentError("without --perturb all forks have the same bits; add --perturb 1ulp")
    for option, given in (("--inevitable", when), ("--times", times is not None)):
        if given and outcome is None:
            raise ExperimentError(f'{option} needs an --outcome, such as "x_0 < 0"')
    if outcome is not None and seeds == 1:
        raise ExperimentError("--outcome counts forks: add --perturb 1ulp --seeds 100")
    target = output or file.with_name(f"{file.stem}-fork.rrd")
    refuse_output(target, force)
    with opened(file) as path:
        refuse_itself(target, path)
        recording = Recording.open(path)
        with replaying(recording) as watch:
            moment = asked.end(recording, watch)
        assert moment is not None, "one option was given"
        branch = Branch(path, moment, tuple(overrides or ()))
        start = start_of(branch)
        if seeds == 1:
            document, lines, early = _one(start, target, None if perturb is None else 1, ulps)
        else:
            document, lines = _many(start, branch, target, seeds, ulps, outcome, times or DEFAULT_TIMES, when)
            early = False
    CommandAnswer(document, [*lines, f"{target} written; {command('view', target)}"]).say(as_json)
    if early:
        raise typer.Exit(1)


def _one(start: ForkStart, target: Path, shift: int | None, ulps: int) -> tuple[dict[str, Any], list[str], bool]:
    """Run one fork; return its document, its description, and whether it ended early."""
    from carom.lab.diff.divergence import rate_text
    from carom.lab.fork.fork import ended_early, text_of
    from carom.lab.fork.fork import fork as go_on

    outcome, found = go_on(start, target, shift, ulps)
    text = text_of(start, found)
    document = {
        "units": start.scene.unit_system.recorded,
        "at": start.checkpoint.time,
        "step": start.checkpoint.step,
        "end": outcome.sim_time,
        "steps": outcome.steps,
        "status": outcome.status,
        "scene": {key: list(values) for key, values in found.scene.items()},
        "text": text,
        "rms": float(found.curve.rms[-1]),
        "floor": float(found.curve.floor[-1]),
    }
    lines = [f"{text[0].upper()}{text[1:]}."]
    early = ended_early(outcome)
    if early:
        lines.append(early)
    elif not outcome.ok:
        lines.append(f"The fork missed a promise of its scene: {outcome.reason}.")
    growth = found.divergence
    if growth is not None and growth.is_exponential:
        rate = rate_text(growth.rate, growth.standard_error, start.scene.unit_system)
        lines.append(f"The distance grows as e^(λt), λ = {rate}.")
    return document, lines, bool(early)


def _many(
    start: ForkStart, branch: Branch, target: Path, seeds: int, ulps: int, outcome: str | None, times: int, when: bool
) -> tuple[dict[str, Any], list[str]]:
    from dataclasses import replace

    from carom.lab.fork.branch import PerturbedTask, by_seed, outcome_of, results_of
    from carom.lab.fork.fork import Chance, chances, ensemble, inevitable, write_ensemble
    from carom.physics.jit import cores
    from carom.runs.workers import LocalWorkers
    from carom.scene.units.dimension import TIME

    units = start.scene.unit_system
    expression = None if outcome is None else outcome_of(start, outcome)  # checked before the workers start

    with LocalWorkers(min(cores(), seeds)) as workers, LiveLine() as line:

        def update(done: int, at: float = start.checkpoint.time) -> None:
            line._show(lambda now: f"{bar(done / seeds)} {done} of {seeds} forks at t = {units.text(at, TIME)}")

        def draw(time: float) -> Iterator[bool]:
            tasks = [PerturbedTask(replace(branch, at=time), seed, ulps, outcome) for seed in range(1, seeds + 1)]
            for done, result in enumerate(by_seed(results_of(tasks, workers)), 1):
                update(done, time)
                yield bool(result.outcome)

        found = ensemble(start, branch, seeds, ulps, lambda tasks: results_of(tasks, workers), expression, update)
        begin, end, moment = start.checkpoint.time, start.scene.time.duration, None
        if outcome is not None:
            here = Chance(begin, sum(found.outcomes), len(found.outcomes))
            steps = start.recording.steps("dt")
            last = float(steps["time"][-1].as_py() - steps["dt"][-1].as_py())  # s, start of the last step
            found = replace(found, chances=[here, *chances(draw, begin, end, times, last)])
        if when:
            came = bool(found.reference_outcome)
            moment = inevitable(lambda time: (hit == came for hit in draw(time)), begin, end)
    document = _document(start, found, outcome, moment)
    lines = list(_lines(start, found, outcome, moment))
    write_ensemble(start, found, markdown(lines), target)
    return document, lines


def _document(start: ForkStart, found: Ensemble, outcome: str | None, moment: Inevitable | None) -> dict[str, Any]:
    from dataclasses import asdict

    import numpy as np

    answer = None
    if outcome is not None:
        answer = {
            "condition": outcome,
            "unperturbed": found.reference_outcome,
            "forks": len(found.outcomes),
            "hits": sum(found.outcomes),
            "chances": [
                asdict(chance) | {"probability": chance.probability, "band": list(chance.band)}
                for chance in found.chances
            ],
            "inevitable": None if moment is None else asdict(moment),
        }
    return {
        "units": start.scene.unit_system.recorded,
        "at": start.checkpoint.time,
        "step": start.checkpoint.step,
        "seeds": len(found.rms),
        "time": found.time.tolist(),
        "low": found.band[0].tolist(),
        "median": found.band[1].tolist(),
        "high": found.band[2].tolist(),
        "growth": None if found.growth is None else asdict(found.growth),
        "rates": {
            "count": len(found.rates),
            "median": float(np.median(found.rates)) if len(found.rates) else None,
            "spread": found.rate_error,
        },
        "spread": found.spread[-1].tolist() if len(found.spread) else [],
        "outcome": answer,
    }


def _lines(start: ForkStart, found: Ensemble, outcome: str | None, moment: Inevitable | None) -> Iterator[str]:
    import numpy as np

    from carom.lab.diff.divergence import rate_text
    from carom.scene.units.dimension import LENGTH, TIME

    units = start.scene.unit_system

    def at(time: float) -> str:
        return f"t = {units.text(time, TIME, '.9g')}"

    low, median, high = found.band[:, -1].tolist()
    radius = start.recording.bodies.radius
    begin, end = at(start.checkpoint.time), at(found.time[-1])
    yield f"{len(found.rms)} forks at step {start.checkpoint.step}, {begin}, up to {end}."
    yield (
        f"At {end} bodies are {units.text(median, LENGTH, '.3g')} apart (rms, median); "
        f"5 to 95 %: {units.span(low, high, LENGTH, '.3g')}."
    )
    lost = int(np.count_nonzero(found.spread[-1] > radius))
    yield f"{lost} of {len(radius)} bodies can no longer be predicted to within their radius."
    if len(found.rates):
        rate = float(np.median(found.rates))
        yield (
            f"The distance grows as e^(λt), λ = {rate_text(rate, found.rate_error, units)}, and doubles every "
            f"{units.text(np.log(2.0) / rate, TIME, '.3g')}."
        )
    else:
        yield "The distance does not grow exponentially."
    if outcome is not None:
        hits, forks = sum(found.outcomes), len(found.outcomes)
        known = "holds" if found.reference_outcome else "does not hold"
        yield f"{outcome}: in {hits} of {forks} forks, {hits / forks:.0%}; without perturbation it {known}."
        for chance in found.chances[1:]:
            low, high = chance.band
            yield f"  forked at {at(chance.time)}: {chance.probability:.0%} ({low:.0%} to {high:.0%})"
    if moment is not None:
        for tested in moment.tested:
            yield f"  forked at {at(tested.time)}: {tested.hits} of {tested.forks} have the same outcome"
        if moment.always:
            yield f"The outcome of the unperturbed run was already inevitable at {at(moment.latest)}; fork earlier."
        else:
            yield (
                f"The outcome of the unperturbed run was inevitable from {at(moment.latest)} on, "
                f"but not yet at {at(moment.earliest)}."
            )
