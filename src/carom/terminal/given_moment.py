"""The moment that a user requests with one of ``--at``, ``--step`` and ``--event``."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any

import typer

from carom.terminal.options import OptionalTime, TypedTime, simulated, time_option

if TYPE_CHECKING:
    from carom.physics.simulation import StepStatus
    from carom.recording.read.recording import Recording

_STEP = "The moment is the end of this step."
_EVENT = "The moment is an event: a moment that `carom inspect` lists, a kind of event, or impact:N for the Nth impact."
StepOption = Annotated[int | None, typer.Option("--step", metavar="N", min=0, help=_STEP, show_default=False)]
EventOption = Annotated[str | None, typer.Option("--event", metavar="NAME", help=_EVENT)]


def at_option(default: str) -> Any:
    """Return the option ``--at`` for a command that requires a moment."""
    return time_option("--at", f"Simulated time; a time that carom printed selects its step. Default: {default}.")


AtOption = Annotated[
    OptionalTime, at_option("the hardest impact or, without any, the most contacts, the middle of a slide, or the end")
]  # default: the moment that `Recording.moment` returns


def typed_time_or_none(recording: Recording, given: float | None) -> float | None:
    """Return the result of `typed_time`; None stays None."""
    return None if given is None else typed_time(recording, given)


def typed_time(recording: Recording, given: float) -> float:
    """Return the time (s) of a recording for a time that was typed.

    The moment is the nearest end of a recorded step, or the nearest moment of `carom inspect`, that prints with the
    same digits; otherwise, it is the time as typed.
    """
    time = simulated(given, recording.units)
    if isinstance(given, TypedTime):
        from carom.recording.read.lookup import printed_time

        return printed_time(recording, time, given.rounding * abs(time))
    return time


@dataclass(frozen=True, slots=True)
class GivenMoment:
    """The options of a command that select a moment. Raises RecordingError if there are several."""

    at: OptionalTime
    step: int | None
    event: str | None

    def __post_init__(self) -> None:
        """Refuse several moments."""
        from carom.errors import RecordingError

        if len(given := self._given) > 1:
            raise RecordingError(f"give {' or '.join(given)}, not {'both' if len(given) == 2 else 'all three'}")

    @property
    def _given(self) -> list[str]:
        options = {"--at": self.at, "--step": self.step, "--event": self.event}
        return [name for name, value in options.items() if value is not None]

    @property
    def option(self) -> str | None:
        """The option that was given; None if there is none."""
        return next(iter(self._given), None)

    @property
    def given(self) -> float | int | str | None:
        """The value of the given option."""
        return next((value for value in (self.at, self.step, self.event) if value is not None), None)

    def time(self, recording: Recording, watch: Callable[[StepStatus], None] | None = None) -> float | None:
        """Return the time (s) of ``--at`` or ``--step``; None without either. ``watch`` is called in a rerun."""
        if self.step is not None:
            from carom.runs.recomputed import time_of_step

            return time_of_step(recording, self.step, watch)
        return typed_time_or_none(recording, self.at)

    def end(self, recording: Recording, watch: Callable[[StepStatus], None] | None = None) -> float | None:
        """Return the given time, or the time (s) of an event: the end of its step if this step has a frame."""
        if self.event is None:
            return self.time(recording, watch)
        from carom.recording.read.named_events import named_event

        return named_event(recording, self.event).end(recording)
