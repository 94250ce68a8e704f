"""The progress of a run on the terminal, and its summary at the end."""

from __future__ import annotations

import sys
from itertools import zip_longest
from typing import Self

from rich.table import Table
from rich.text import Text

from carom.physics.look_ahead.trial_run import Watcher, WorkBudget
from carom.physics.simulation import StepStatus
from carom.physics.space import Space
from carom.plan.auto import frame_interval, largest_step
from carom.plan.checks import doubts
from carom.plan.known_errors import ended_bounces, inexact_impacts, inexact_orbits
from carom.runs.outcome import accuracy_text, counts_text, error_text, in_words, overlap_text
from carom.runs.outlook import forewarning
from carom.runs.run import Outcome, shortfall_text
from carom.scene.load import Scene
from carom.scene.units.dimension import TIME
from carom.scene.units.system import UnitSystem
from carom.scene.wording import command, counted
from carom.terminal.console import LiveLine, Patience, Terminal, bar
from carom.terminal.printing import bytes_text, duration_text, simulated_text, warning_lines

MANY_STEPS = 10_000_000  # number of steps that take at least some 10 s
LEAST_FRAMES = 0.9  # if less than this fraction of the requested frames is recorded, a note says so
FEW_STEPS = 1000  # largest number of steps without a frame for which a note suggests recording every step
FEW_FRAMES = 0.2  # like `LEAST_FRAMES`, but applied to the automatic number of frames, which nobody requested


class RunProgress(LiveLine):
    """Simulated time, pace and remaining time of a run; at the end, its outcome."""

    def __init__(self, scene: Scene, quiet: bool = False, heading: str = "") -> None:
        super().__init__(quiet)
        self._scene = scene
        self._heading = heading  # text before the title

    @property
    def units(self) -> UnitSystem:
        """The units of the scene."""
        return self._scene.unit_system

    def __enter__(self) -> Self:
        self._restart()
        scene = self._scene
        length = simulated_text(scene.time.duration, scene.unit_system)
        self.say(f"{self._heading}{scene.title}: {counted(scene.count, 'body')}, {length}")
        for note in notes_on(scene):
            self.say(note)
        # a run may be long because of the largest allowed step, unless another key sets the step
        time, largest = scene.time, largest_step(scene)
        if time.fixed_dt is None and time.accuracy is None and time.duration / largest >= MANY_STEPS:
            longest = scene.unit_system.text(largest, TIME, "g")
            self.say(
                f"carom: time.max_dt = {longest} causes at least {time.duration / largest:.2g} steps; for "
                "fewer steps, raise it or set time.accuracy (`carom explain` shows the limit that then applies)"
            )
        return super().__enter__()

    def announce(self, scene: Scene) -> None:
        """Print the limits of the scene's promise of an accuracy, which may end the run early."""
        self._scene = scene
        if shortfall := shortfall_text(scene):
            self.say(f"carom: {shortfall}")

    def forewarn(self, space: Space) -> None:
        """Announce a long run, and why it will take long."""
        if text := forewarning(space):
            self.say(f"carom: {text}")

    def update(self, status: StepStatus) -> None:
        """Show the progress of the run."""
        self._show(lambda now: self._line(status, now))

    def _line(self, status: StepStatus, now: float) -> str:
        done = min(1.0, status.time / self._scene.end)
        spent = max(now - self._began, 1e-9)
        left = duration_text(spent * (1 - done) / done) if done > 0 else "?"
        units = self._scene.unit_system
        at, dt = units.text(status.time, TIME, ".5g"), units.text(status.dt, TIME, ".3g")
        return (
            f"{bar(done)} {done:4.0%}  t = {at}  step {status.step} "
            f"({status.step / spent:.0f}/s)  dt = {dt} ({status.dt_limit})  {counted(status.contacts, 'contact')}  "
            f"energy error {status.energy_error:.1e}  {left} left"
        )

    def summarise(self, outcome: Outcome) -> None:
        """Print the outcome of the run, its measurements, and commands for the file."""
        moments, units = outcome.moments, self._scene.unit_system
        table = Table.grid(padding=(0, 2))
        table.add_row("outcome", Text(in_words(outcome.status), style="green" if outcome.ok else "red"))
        simulated = f"{counted(outcome.steps, 'step')}, {units.text(outcome.sim_time, TIME)} simulated"
        part = f", from t = {units.text(outcome.begin, TIME)} on" if outcome.begin > 0.0 else ""
        table.add_row("run", f"{simulated}{part} in {duration_text(outcome.wall_time)}")
        if moments.energy_error:
            table.add_row(
                "energy",
                f"integration error at most {error_text(moments.energy_error.value)} of the energy scale",
            )
        linear, angular = moments.momentum_error, moments.angular_momentum_error
        if linear is None:
            table.add_row("momentum", "not checked, since planes, walls or fixed bodies may change it")
        else:
            angular_text = "not conserved in a periodic box" if angular is None else error_text(angular.value)
            table.add_row("momentum", f"error at most {error_text(linear.value)}, angular {angular_text}")
        if moments.overlap and moments.contacts:
            counts = counts_text(moments.total_contacts, moments.impacts, outcome.impacts_counted)
            table.add_row("contacts", counts)
            if outcome.impacts:
                table.add_row("", f"impacts: {outcome.impacts.text(moments.impacts)}")
            most = f"at most {moments.contacts.value:.0f} at once"
            table.add_row("", "; ".join(filter(None, (most, overlap_text(moments.overlap.value)))))
        elif moments.total_contacts == 0 and self._scene.contact.enabled:
            table.add_row("contacts", "none: nothing touched")
        if outcome.accuracy:
            table.add_row("accuracy", accuracy_text(outcome.accuracy, units))
        for line in warning_lines(outcome.warnings, units):
            table.add_row(Text("warning", style="yellow"), Text(line))
        for verdict in outcome.verdicts:
            kept = Text("expected" if verdict.judged else "not judged")
            table.add_row(kept if verdict.met else Text("missed", style="red"), verdict.text(units))
        table.add_row("file", f"{outcome.path}, {bytes_text(outcome.size)}, {counted(outcome.frames, 'frame')}")
        if fewer := _fewer_frames(self._scene, outcome):
            table.add_row("", fewer)
        resumed = ("resume",) if outcome.status == "interrupted" else ()
        terminal = Terminal(file=sys.stdout)
        terminal.print(table)
        for label, name in zip_longest(("next",), (*resumed, "view", "inspect", "picture"), fillvalue=""):
            # in one line, for copying
            terminal.print(Text(f"{label:<10}{command(name, outcome.path)}"), soft_wrap=True)


def notes_on(scene: Scene) -> list[str]:
    """Return notes before a run: about files, test particles, impacts, orbits, and probable mistakes."""
    notes = [note for notes in scene.notes for note in notes]
    if count := scene.test_particles:
        are = "is a test particle" if count == 1 else "are test particles"
        notes.append(
            f"{count} of {counted(scene.count, 'body')} {are} (mass 0): attracted, but not attracting; the checks of "
            "energy and momentum do not cover them"
        )
    errors = inexact_impacts(scene), ended_bounces(scene), inexact_orbits(scene)
    return [*notes, *filter(None, errors), *doubts(scene)]


def preparing(scene: Scene, beside: LiveLine) -> Patience:
    """Announce long work before the first step: placing bodies, or the look-ahead of an accuracy."""
    if scene.time.accuracy is None or scene.promise is not None:
        return Patience(f"preparing {scene.count} bodies …", beside)
    return Patience(f"choosing the step for accuracy = {scene.time.accuracy:g}:", beside, everywhere=True)


def watch_look_ahead(scene: Scene, patience: Patience) -> Watcher:
    """Return the function that shows the progress of a look-ahead."""

    def watch(budget: WorkBudget) -> None:
        reached = scene.unit_system.text(budget.reached, TIME, ".4g")
        patience.detail(f"a trial run at t = {reached}, {min(1.0, budget.spent / budget.total):.0%} of the budget")

    return watch


def _fewer_frames(scene: Scene, outcome: Outcome) -> str:
    """Return a note if steps were too long for the requested or the usual number of frames; otherwise an empty text."""
    interval = frame_interval(scene)
    if interval == 0.0:
        return ""
    expected = outcome.sim_time / interval + 1.0  # includes a frame of the initial state
    automatic = scene.record.every == "auto"
    if outcome.frames >= (FEW_FRAMES if automatic else LEAST_FRAMES) * expected:
        return ""
    limit = scene.unit_system.text(interval, TIME, ".3g" if automatic else "g")
    if automatic:
        long = f"frames are recorded at ends of steps, and steps were long; time.max_dt = {limit} gives more frames"
        # steps may be shorter than the interval of frames, for instance in a close encounter
        without = outcome.steps + 1 - outcome.frames
        if 0 < without <= FEW_STEPS:
            long += f', and record.every = "step" the {counted(without, "short step")} between them'
        return long
    return (
        f"{expected:.0f} frames were requested, but frames are recorded only at ends of steps, and most steps are "
        f"longer than record.every; time.max_dt = {limit} records all frames"
    )
