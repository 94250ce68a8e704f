"""The terminal: a console for text from files, and the lines that report the progress of long work."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Self

from rich.console import Console, ConsoleOptions, RenderableType
from rich.live import Live
from rich.segment import Segment
from rich.table import Table
from rich.text import Text

from carom.scene.units.dimension import TIME
from carom.scene.units.system import UnitSystem
from carom.scene.wording import escaped
from carom.terminal.printing import VERBOSITY, duration_text

if TYPE_CHECKING:
    from carom.arrays import FloatArray
    from carom.physics.simulation import StepStatus
    from carom.recording.read.recording import Recording

WIDEST = 10_000  # width, in characters, of a table that is printed whole
LINE_EVERY = 5.0  # s between lines if the output is not a terminal
BAR = 24  # characters of a bar
# s that a movie at 1280 x 720 takes on two cores without a graphics card: until the first picture, per picture, per
# body
_STARTING, _PICTURE, _PICTURE_OF_BODY = 8.0, 0.2, 0.001
PATIENCE = 1.0  # s, time after which a line names the work


class Terminal(Console):
    """A console without markup by default, with control characters as escapes; ``piped`` is its width in a pipe."""

    def __init__(self, *, piped: int | None = None, **options: Any) -> None:
        if options.get("stderr") and VERBOSITY.is_quiet:
            options["quiet"] = True
        super().__init__(**{"markup": False, "highlight": False, **options})
        if piped is not None and not self.is_terminal:
            self.width = piped

    def render(self, renderable: RenderableType, options: ConsoleOptions | None = None) -> Iterable[Segment]:
        """Render the text with control characters escaped."""
        for segment in super().render(renderable, options):
            yield segment if segment.control else Segment(escaped(segment.text), segment.style)


def print_whole(table: Table) -> None:
    """Print a table without cutting cells, wider than the terminal if necessary."""
    console = Terminal()
    needed = console.measure(table, options=console.options.update(width=WIDEST)).maximum
    console.width = max(console.width, needed)
    console.print(table)


class LiveLine:
    """A line on stderr, rewritten in place on a terminal and printed every few seconds elsewhere."""

    # returns a text to show in place of the line, at a time in s
    interlude: ClassVar[Callable[[float], str]] = staticmethod(lambda now: "")
    is_live: ClassVar[bool] = False  # whether any progress is shown on the terminal

    def __init__(self, quiet: bool = False) -> None:
        self._console = Terminal(stderr=True, quiet=quiet)
        self._live: Live | None = None
        self._began = self._last_line = time.perf_counter()

    def __enter__(self) -> Self:
        if self._console.is_terminal and not self._console.quiet:
            self._start(Live(console=self._console, refresh_per_second=8, transient=True))
        return self

    def __exit__(self, *_: object) -> None:
        if self._live:
            self._live.stop()
            self._live, LiveLine.is_live = None, False

    def _start(self, live: Live) -> None:
        live.start()
        self._live, LiveLine.is_live = live, True

    def say(self, text: str) -> None:
        """Print a line that stays."""
        self._console.print(text, soft_wrap=True)

    def _restart(self) -> None:
        """Restart the clock."""
        self._began = self._last_line = time.perf_counter()

    def _show(self, line: Callable[[float], str]) -> None:
        """Show the current line, made by a function of the clock (s)."""
        now = time.perf_counter()
        if self._live:
            self._live.update(Text(LiveLine.interlude(now) or line(now)))
        elif now - self._last_line >= LINE_EVERY:
            self._last_line = now
            self.say(line(now))


class Patience(LiveLine):
    """A line on the terminal that names work that takes longer than `PATIENCE`.

    The line is shown on the console of ``beside``, and the interlude replaces its text. With ``everywhere``, the line
    is also printed every `LINE_EVERY` if the output is not a terminal.
    """

    def __init__(self, text: str, beside: LiveLine, *, everywhere: bool = False) -> None:
        super().__init__()
        self._everywhere = everywhere
        self._console = beside._console  # texts that are printed on this console appear above the line
        self._text, self._detail = text, ""
        self._timer = threading.Timer(PATIENCE, self._begin)
        self._timer.daemon = True

    def __enter__(self) -> Self:
        self._restart()
        if (self._console.is_terminal or self._everywhere) and not self._console.quiet:
            self._timer.start()
        return self

    def detail(self, text: str) -> None:
        """Set the text that follows the name of the work."""
        self._detail = text
        is_due = time.perf_counter() - self._last_line >= LINE_EVERY
        if self._everywhere and is_due and not (self._console.is_terminal or self._console.quiet):
            self._begin()

    def __exit__(self, *_: object) -> None:
        self._timer.cancel()
        if self._timer.is_alive():
            self._timer.join()
        super().__exit__()

    def _begin(self) -> None:
        if not self._console.is_terminal:
            self._last_line = time.perf_counter()
            self.say(str(self._line()))
            return
        self._start(Live(console=self._console, refresh_per_second=8, transient=True, get_renderable=self._line))

    def _line(self) -> Text:
        text, now = f"{self._text} {self._detail}".strip(), time.perf_counter()
        return Text(LiveLine.interlude(now) or f"{text}  {duration_text(now - self._began)}")


def bar(done: float) -> str:
    """Draw a fraction from 0 to 1."""
    full = int(done * BAR)
    return f"{'━' * full}{'╌' * (BAR - full)}"


@contextmanager
def replaying(recording: Recording) -> Iterator[Callable[[StepStatus], None]]:
    """Show the progress of a replay if it takes a while; yield the function to call after each frame."""
    length = float(recording.fingerprints()["time"][-1].as_py()) if recording.frames else 0.0
    with LiveLine() as line:

        def update(status: StepStatus) -> None:
            done = min(1.0, status.time / length) if length else 1.0
            reached = recording.units.text(status.time, TIME, ".5g")
            line._show(lambda now: f"{bar(done)} {done:4.0%}  rerun up to t = {reached}")

        yield update


class MovieProgress(LiveLine):
    """Progress of a movie whose pictures show the frames at given times (s)."""

    def __init__(self, path: Path, times: FloatArray, units: UnitSystem, bodies: int) -> None:
        super().__init__()
        self._made, self._count = 0, len(times)
        self._first: float | None = None  # time of the first picture; until then, the viewers were starting
        self._last = 0.0
        frames = len(set(times.tolist()))
        shown = "" if frames == len(times) else f", of {frames} different moments"
        span = units.span(times[0], times[-1], TIME)
        expected = _STARTING + frames * (_PICTURE + bodies * _PICTURE_OF_BODY)
        self.say(f"{path}: {len(times)} pictures{shown}, from {span}; about {duration_text(expected)}")

    def __enter__(self) -> Self:
        super().__enter__()
        self._show(self._line)
        return self

    def watched(self, pictures: Iterable[bytes]) -> Iterator[bytes]:
        """Yield the pictures, and show their number."""
        for picture in pictures:
            self._made += 1
            self._last = time.perf_counter()
            self._first = self._first or self._last
            self._show(self._line)
            yield picture

    def summary(self) -> str:
        """Describe the number of pictures and the mean time to render one."""
        return f"{self._made} pictures, rendered in {self._pace():.2g} s each"

    def _pace(self) -> float:
        """Return the mean time (s) to render a picture, without the start of the viewers."""
        return (self._last - (self._first or self._last)) / max(1, self._made - 1)

    def _line(self, now: float) -> str:
        done = self._made / self._count
        if self._made < 2:
            return f"{bar(done)} {done:4.0%}  starting the viewers  {duration_text(now - self._began)}"
        left = duration_text(self._pace() * (self._count - self._made))
        return f"{bar(done)} {done:4.0%}  picture {self._made} of {self._count}  {left} left"
