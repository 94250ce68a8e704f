"""How warnings of a run are shown: the first few of each kind, and how many there were."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from carom.event import Event
from carom.scene.units.dimension import TIME
from carom.scene.units.system import UnitSystem

SHOWN = 3  # of a kind; the recording has all of them


def warning_lines(warnings: Sequence[Event], units: UnitSystem, *, in_full: bool = False) -> Iterator[str]:
    """Yield the lines to print, kind by kind, in the order in which the kinds first occurred.

    Parameters
    ----------
    warnings
        In order of time.
    units
        Of the scene.
    in_full
        Whether the first of each kind is shown with the contacts and bodies that it names, or its first line alone.
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
            yield f"… and {len(events) - SHOWN} more like it, {ago}"
