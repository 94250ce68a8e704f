"""`carom stress`: the extreme scenes, each with its criteria and the measured values."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from carom.errors import SceneError
from carom.scene.scene_file import EXTREMES, extreme_scenes
from carom.scene.units.dimension import TIME
from carom.scene.wording import command, suggestion
from carom.state.books import Extreme
from carom.terminal.options import JsonOption, SetOption, output_option
from carom.terminal.printing import duration_text, say_json

if TYPE_CHECKING:
    from rich.table import Table

    from carom.runs.outcome import Verdict
    from carom.runs.run import Outcome, Watcher
    from carom.scene.load import Scene


PIPE_WIDTH = 140  # width of the table in characters if the output is not a terminal
_FOLDER = Path("recordings/stress")


@dataclass(frozen=True, slots=True)
class Trial:
    """An extreme scene and the result of its run."""

    name: str
    scene: Scene
    outcome: Outcome | None  # None if the scene was refused before the run
    refusal: str = ""

    @property
    def met(self) -> bool:
        """Whether the run completed and met every criterion."""
        return self.outcome is not None and self.outcome.ok

    @property
    def status(self) -> str:
        """The outcome in one or two words."""
        return self.outcome.status if self.outcome else "refused"

    @property
    def reason(self) -> str:
        """Why the run did not complete or missed a criterion; empty if it met all criteria."""
        return self.outcome.reason if self.outcome else self.refusal

    @property
    def verdicts(self) -> list[Verdict]:
        """Each criterion and its measured value."""
        return self.outcome.verdicts if self.outcome else []

    @property
    def worst(self) -> dict[str, Extreme]:
        """The worst moment of each missed criterion; for a failed run, also its end."""
        from carom.state.books import Extreme

        extremes = {verdict.name: verdict.worst for verdict in self.verdicts if not verdict.met and verdict.worst}
        if self.outcome and self.status == "failed":
            extremes["the end"] = Extreme(self.outcome.sim_time, self.outcome.steps, self.outcome.sim_time)
        return extremes


def extremes(name: str | None = None) -> dict[str, Path]:
    """Return the scene files of all extremes, or of one named extreme, by short name; refuse an unknown name."""
    known = {full.removeprefix(f"{EXTREMES}/"): path for full, path in extreme_scenes().items()}
    if name is None:
        return known
    short = name.removeprefix(f"{EXTREMES}/")
    if short in known:
        return {short: known[short]}
    raise SceneError(f"{name}: no extreme of that name; {suggestion(short, known)}")


def attempt(name: str, scene: Scene, folder: Path, *, watch: Watcher | None = None) -> Trial:
    """Run an extreme and record it under its short name, replacing an earlier recording."""
    from carom.runs.run import recording_space, simulate

    try:
        space = recording_space(scene)
    except SceneError as error:
        return Trial(name, scene, None, str(error))
    return Trial(name, scene, simulate(space, folder / f"{name}.rrd", force=True, watch=watch))


def stress(
    name: Annotated[str | None, typer.Argument(metavar="NAME", help="One of the extremes. Default: all.")] = None,
    folder: Annotated[Path, output_option("DIR", "Folder for the recordings; replaces earlier ones.")] = _FOLDER,
    overrides: SetOption = None,
    as_json: JsonOption = False,
) -> None:
    """Run the scenes at the limits of the method and compare each with its criteria; exit with 1 on a miss."""
    from rich.markup import escape

    from carom.recording.write.whole_file import output_folder
    from carom.runs.environment import versions
    from carom.runs.outcome import in_words
    from carom.scene.load import Scene
    from carom.terminal.compilation import announce_compilation
    from carom.terminal.console import Terminal
    from carom.terminal.progress import RunProgress

    scenes = {short: Scene.load(path, overrides) for short, path in extremes(name).items()}
    output_folder(folder)
    if not as_json:
        announce_compilation()
    trials: list[Trial] = []
    try:
        for number, (short, scene) in enumerate(scenes.items(), start=1):
            with RunProgress(scene, quiet=as_json, heading=f"{number}/{len(scenes)}  {short}: ") as progress:
                trials.append(attempt(short, scene, folder, watch=progress.update))
            if trials[-1].status == "interrupted":
                break
    except KeyboardInterrupt:  # the interrupt came between two runs; an interrupted run reports its end itself
        pass
    met = sum(trial.met for trial in trials)
    if as_json:
        entries = [_entry(trial) for trial in trials]
        say_json({"met": met, "asked": len(scenes), "versions": versions(), "extremes": entries})
    else:
        # the table, then each miss with its worst moments
        console = Terminal(markup=True, piped=PIPE_WIDTH)
        console.print(_table(trials))
        for trial in trials:
            if not trial.met:
                status = f"\n[red]{trial.name}[/red]: {in_words(trial.status)}"
                console.print(f"{status}: {escape(trial.reason)}", soft_wrap=True)
                console.print(_worst(trial), soft_wrap=True)
        not_run = f"; {len(scenes) - len(trials)} were not run" if len(trials) < len(scenes) else ""
        console.print(f"\n{met} of {len(scenes)} extremes met their criteria{not_run}.")
    if met < len(scenes):
        raise typer.Exit(1)


def _table(trials: list[Trial]) -> Table:
    from rich import box
    from rich.markup import escape
    from rich.table import Table

    from carom.runs.outcome import in_words

    table = Table(box=box.SIMPLE_HEAD, pad_edge=False, show_lines=True)
    for heading in ("extreme", "description and recording"):
        table.add_column(heading, overflow="fold")
    for heading in ("criterion", "measured", "met", "time"):
        table.add_column(heading, no_wrap=True)
    for trial in trials:
        verdicts, outcome = trial.verdicts, trial.outcome
        recorded = f"\n[dim]{escape(str(outcome.path))}[/dim]" if outcome else ""
        limits = [f"{verdict.name} {'≥' if verdict.at_least else '≤'} {verdict.limit:.3g}" for verdict in verdicts]
        measured = [f"{verdict.measured:.2g}" for verdict in verdicts]
        met = [
            "not judged" if not verdict.judged else "yes" if verdict.met else "[red]NO[/red]" for verdict in verdicts
        ]
        if not trial.met and trial.status != "expectation missed":
            met = [f"[red]{in_words(trial.status)}[/red]"]
        cells = ("\n".join(lines) for lines in (limits, measured, met))
        wall_time = duration_text(outcome.wall_time) if outcome else ""
        table.add_row(trial.name, escape(trial.scene.title) + recorded, *cells, wall_time)
    return table


def _worst(trial: Trial) -> Table:
    """Show each worst moment with the command that displays it."""
    from rich.markup import escape
    from rich.table import Table

    table, units = Table.grid(padding=(0, 2)), trial.scene.unit_system
    for what, moment in trial.worst.items():
        time = units.shown(moment.time, TIME)
        look = command("view", trial.outcome.path, "--at", f"{time:.9g}") if trial.outcome else ""
        when = f"t = {units.text(moment.time, TIME)}"
        table.add_row(f"  {what}", f"step {moment.step}", when, escape(moment.between), escape(look))
    return table


def _entry(trial: Trial) -> dict[str, Any]:
    entry: dict[str, Any] = {
        "name": trial.name,
        "title": trial.scene.title,
        "units": trial.scene.unit_system.recorded,
        "met": trial.met,
        "status": trial.status,
        "reason": trial.reason,
        "criteria": [
            {**asdict(verdict), "bound": verdict.bound, "met": verdict.met, "judged": verdict.judged}
            for verdict in trial.verdicts
        ],
        "worst": {what: asdict(moment) for what, moment in trial.worst.items()},
    }
    if outcome := trial.outcome:
        entry |= {name: getattr(outcome, name) for name in ("steps", "sim_time", "wall_time")}
        entry["recording"] = str(outcome.path)
    return entry
