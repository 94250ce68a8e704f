"""The progress bar of `carom.run`, in a terminal or a notebook."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

from carom.physics.status import StepStatus
from carom.scene.schema import Scene
from carom.scene.units.dimension import TIME


@contextmanager
def progress_bar(scene: Scene) -> Iterator[Callable[[StepStatus], None]]:
    """Show a progress bar, and yield what moves it."""
    end, units = scene.time.duration, scene.unit_system
    columns = TextColumn("{task.description}"), BarColumn(), TaskProgressColumn(), TextColumn("{task.fields[now]}")
    with Progress(*columns, TimeRemainingColumn()) as shown:
        task = shown.add_task(scene.title, total=end, now="")

        def move(status: StepStatus) -> None:
            now = f"t = {units.text(status.time, TIME, '.5g')}, step {status.step}, {status.contacts} contacts"
            shown.update(task, completed=min(status.time, end), now=now)

        yield move
