"""The terminal: what commands print – text, JSON, quantities, tables, and the progress of long work."""

from __future__ import annotations

import math
import shlex
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self

import typer
from rich.console import Console, ConsoleOptions, RenderableType
from rich.live import Live
from rich.segment import Segment
from rich.table import Table
from rich.text import Text

from carom.event import Event
from carom.scene.units.dimension import TIME
from carom.scene.units.system import UnitSystem
from carom.scene.wording import command, escaped

if TYPE_CHECKING:
    from carom.arrays import FloatArray
    from carom.physics.simulation import StepStatus
    from carom.recording.read.recording import Recording

WIDEST = 10_000  # characters, of a table that is printed whole
LINE_EVERY = 5.0  # s between lines where the output is not a terminal
BAR = 24  # characters
PATIENCE = 1.0  # s of work before a line names it


class Terminal(Console):
    """A console that prints text unchanged: no markup unless requested, and control characters as escapes."""

    def __init__(self, **options: Any) -> None:
        super().__init__(**{"markup": False, "highlight": False, **options})

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

    def __init__(self, quiet: bool = False) -> None:
        self._console = Terminal(stderr=True, quiet=quiet)
        self._live: Live | None = None
        self._began = self._last_line = time.perf_counter()

    def __enter__(self) -> Self:
        if self._console.is_terminal and not self._console.quiet:
            self._live = Live(console=self._console, refresh_per_second=8, transient=True)
            self._live.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        if self._live:
            self._live.stop()
            self._live = None

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
            self._live.update(Text(line(now)))
        elif now - self._last_line >= LINE_EVERY:
            self._last_line = now
            self.say(line(now))


class Patience(LiveLine):
    """A line on the terminal that names work which takes longer than `PATIENCE`.

    Parameters
    ----------
    text
        The name of the work.
    beside
        The line that it replaces.
    everywhere
        Whether to print it every `LINE_EVERY` where the output is not a terminal.
    """

    def __init__(self, text: str, beside: LiveLine, *, everywhere: bool = False) -> None:
        super().__init__()
        self._everywhere = everywhere
        self._console = beside._console  # so that text printed there appears above this line
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

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self._timer.cancel()
        if self._timer.is_alive():
            self._timer.join()
        super().__exit__(kind, error, traceback)

    def _begin(self) -> None:
        if not self._console.is_terminal:
            self._last_line = time.perf_counter()
            self.say(str(self._line()))
            return
        self._live = Live(console=self._console, refresh_per_second=8, transient=True, get_renderable=self._line)
        self._live.start()

    def _line(self) -> Text:
        text = f"{self._text} {self._detail}".strip()
        return Text(f"{text}  {duration_text(time.perf_counter() - self._began)}")


def bar(done: float) -> str:
    """Draw a fraction from 0 to 1."""
    full = int(done * BAR)
    return f"{'━' * full}{'╌' * (BAR - full)}"


@contextmanager
def replaying(recording: Recording) -> Iterator[Callable[[StepStatus], None]]:
    """Show the progress of a replay if it takes a while; yield the function to call after each frame."""
    length = float(recording.fingerprints()["time"][-1].as_py()) if recording.frames else 0.0

    def text(status: StepStatus) -> str:
        return recording.units.text(status.time, TIME, ".5g")

    class Line(LiveLine):
        def update(self, status: StepStatus) -> None:
            done = min(1.0, status.time / length) if length else 1.0
            self._show(lambda now: f"{bar(done)} {done:4.0%}  rerun up to t = {text(status)}")

    with Line() as line:
        yield line.update


class MovieProgress(LiveLine):
    """Progress of a movie: pictures made, time for each, and time left."""

    def __init__(self, path: Path, times: FloatArray, units: UnitSystem) -> None:
        super().__init__()
        self._path = path
        self._units = units
        self._times = times  # s, times of the frames in the pictures
        self._made = 0
        self._first: float | None = None  # time of the first picture, before which the viewers were starting
        self._last = 0.0

    def __enter__(self) -> Self:
        self._restart()
        times = self._times
        frames = len(set(times.tolist()))
        shown = "" if frames == len(times) else f", of {frames} recorded frames"
        span = self._units.span(times[0], times[-1], TIME)
        self.say(f"{self._path}: {len(times)} pictures{shown}, from {span}")
        return super().__enter__()

    def watched(self, pictures: Iterable[bytes]) -> Iterator[bytes]:
        """Yield the pictures, and show their number."""
        for picture in pictures:
            self._made += 1
            self._last = time.perf_counter()
            self._first = self._first or self._last
            self._show(self._line)
            yield picture

    def summary(self) -> str:
        """Describe the number of pictures and the time for each."""
        return f"{self._made} pictures, rendered in {self._pace():.2g} s each"

    def _pace(self) -> float:
        """Return the seconds for a picture, without the start of the viewers."""
        return (self._last - (self._first or self._last)) / max(1, self._made - 1)

    def _line(self, now: float) -> str:
        left = duration_text(self._pace() * (len(self._times) - self._made)) if self._made > 1 else "?"
        done = self._made / len(self._times)
        return f"{bar(done)} {done:4.0%}  picture {self._made} of {len(self._times)}  {left} left"


MINUTE, HOUR, DAY, YEAR = 60.0, 3600.0, 86400.0, 365.25 * 86400.0  # s
SHOWN = 3  # warnings of a kind; the recording has all of them
COLOUR = "colour by material"  # used where `colour_by` is "material"; bodies usually have the colour of their group


def say(text: str, *, err: bool = False) -> None:
    """Print a line without control characters: text from files may contain some, and a terminal would execute them."""
    typer.echo(escaped(text), err=err)


def mention_killed_run(file: Path) -> None:
    """Report a run that was killed before it replaced a recording, since the recording does not show it."""
    from carom.recording.write.whole_file import killed_run_of

    if (left := killed_run_of(file)) is not None:
        kept = f"`{command('resume', left)} -o {shlex.quote(str(file))} --force` continues it in place of {file}"
        say(f"carom: {left}: a later run of {file}, which was killed; {kept}, deleting it drops it", err=True)


def finite(value: Any) -> Any:
    """Return a number or a document with None in place of NaN and infinity, which JSON lacks."""
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, dict):
        return {key: finite(inner) for key, inner in value.items()}
    return [finite(inner) for inner in value] if isinstance(value, (list, tuple)) else value


def say_json(document: Any) -> None:
    """Print a JSON document, the only output of a command with ``--json``; NaN and infinity become null."""
    import json

    say(json.dumps(finite(document), indent=2, ensure_ascii=False, allow_nan=False))


def duration_text(seconds: float) -> str:
    """Write a duration in the largest suitable unit."""
    for unit, name in ((YEAR, "years"), (DAY, "d"), (HOUR, "h"), (MINUTE, "min")):
        if seconds >= 2 * unit:
            return f"{seconds / unit:.3g} {name}"
    return f"{seconds:.3g} s"


def simulated_text(seconds: float, units: UnitSystem) -> str:
    """Write a span of simulated time in the unit of the scene or, in SI, in the largest suitable unit."""
    return duration_text(seconds) if units.is_si else units.text(seconds, TIME, ".4g")


def count_text(count: int) -> str:
    """Write an estimated number to three digits."""
    about = float(f"{count:.3g}")
    if about >= 1e9:
        return f"{about:.3g}"
    return f"{about / 1e6:.3g} million" if about >= 1e6 else f"{about:.0f}"


def bytes_text(count: float) -> str:
    """Write a number of bytes in decimal units."""
    for unit, name in ((1e9, "GB"), (1e6, "MB"), (1e3, "kB")):
        if count >= unit:
            return f"{count / unit:.3g} {name}"
    return f"{count:.0f} B"


def warning_lines(warnings: Sequence[Event], units: UnitSystem, *, in_full: bool = False) -> Iterator[str]:
    """Yield the warnings of a run by kind, in the order of first occurrence: the first few of each and their number.

    Parameters
    ----------
    warnings
        In order of time.
    units
        Of the scene.
    in_full
        Whether the first warning of each kind is shown with all its lines, which name contacts and bodies.
    """
    kinds: dict[str, list[Event]] = {}
    for event in warnings:
        kinds.setdefault(event.kind or event.text, []).append(event)
    for events in kinds.values():
        for number, event in enumerate(events[:SHOWN]):
            first, *rest = event.text.splitlines() or [""]
            yield f"step {event.step}, t = {units.text(event.time, TIME)}: {first}"
            if in_full and number == 0:
                yield from (f"    {line}" for line in rest)
        if len(events) > SHOWN:
            last = events[-1]
            ago = f"the last at step {last.step}, t = {units.text(last.time, TIME)}"
            yield f"… and {len(events) - SHOWN} similar ones, {ago}"


def materials_table(materials: list[dict[str, Any]]) -> Table:
    """Show the coefficients of each kind of contact, given `ShownMaterials.described`."""
    table = Table(box=None, pad_edge=False)
    for header in ("material", "bodies", COLOUR, "on", "e", "μs", "μk"):
        table.add_column(header, justify="left" if header in ("material", COLOUR, "on") else "right")
    listed: set[str] = set()
    for material in materials:
        first = (material["name"], str(material["bodies"]), material["colour"])
        for other, coefficients in material["contacts"].items():
            if other in listed:  # listed with the other material
                continue
            table.add_row(*first, other, *(f"{value:.4g}" for value in coefficients.values()))
            first = ("", "", "")
        listed.add(material["name"])
    return table
