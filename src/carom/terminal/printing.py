"""Text and JSON on the terminal, and the quantities and tables that several commands print.

These functions do not import rich, which would take 30 ms: `carom --version` and commands with ``--json`` do not need
it.
"""

from __future__ import annotations

import math
import shlex
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import typer

from carom.event import Event
from carom.scene.units.dimension import TIME
from carom.scene.units.system import UnitSystem
from carom.scene.wording import command, escaped

MINUTE, HOUR, DAY, YEAR = 60.0, 3600.0, 86400.0, 365.25 * 86400.0  # durations in s
SHOWN = 3  # largest number of printed warnings of one kind; the recording has all of them


@dataclass
class Verbosity:
    """The output of a command besides its result, as selected by ``-q`` and ``-v``."""

    is_quiet: bool = False  # whether only warnings and errors are printed, without progress and notes
    is_verbose: bool = False  # whether errors are printed with their traceback


VERBOSITY = Verbosity()


def note(text: str) -> None:
    """Print a line about the progress of a command on stderr, without control characters, unless it is quiet."""
    if not VERBOSITY.is_quiet:
        say(text, err=True)


def say(text: str, *, err: bool = False) -> None:
    """Print a line without control characters, which text from files may contain and a terminal would execute."""
    typer.echo(escaped(text), err=err)


def mention_killed_run(file: Path) -> None:
    """Report a run that was killed before it replaced a recording; the recording itself shows no trace of it."""
    from carom.recording.write.whole_file import killed_run_of

    if (left := killed_run_of(file)) is not None:
        kept = f"`{command('resume', left)} -o {shlex.quote(str(file))} --force` continues it in place of {file}"
        say(
            f"carom: {left}: a later run of {file}, which was killed; {kept}; without {left}, that run is lost",
            err=True,
        )


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
    """Yield the first few warnings of each kind and the number of the others, given all warnings in order of time.

    With ``in_full``, the first warning of each kind is printed with all its lines, which name contacts and bodies.
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
