"""Where a recording that is run again stands."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from carom.cli.live_line import LiveLine, bar
from carom.scene.units.dimension import TIME

if TYPE_CHECKING:
    from carom.physics.simulation import StepStatus
    from carom.recording.read.recording import Recording


@contextmanager
def replaying(recording: Recording) -> Iterator[Callable[[StepStatus], None]]:
    """Show where a replay stands, if there is one and it takes a while."""
    length = float(recording.fingerprints()["time"][-1].as_py()) if recording.frames else 0.0

    def text(status: StepStatus) -> str:
        return recording.units.text(status.time, TIME, ".5g")

    class Line(LiveLine):
        def update(self, status: StepStatus) -> None:
            done = min(1.0, status.time / length) if length else 1.0
            self._show(lambda now: f"{bar(done)} {done:4.0%}  run again to t = {text(status)}")

    with Line() as line:
        yield line.update
