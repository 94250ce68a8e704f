"""`Request`: what a person asks to see of a recording."""

from __future__ import annotations

from dataclasses import dataclass

from carom.errors import RecordingError


@dataclass(frozen=True, slots=True)
class Request:
    """A moment of a recording, the bodies to show close up, plots, and colours.

    Parameters
    ----------
    at
        s; without it, the event, else the most interesting moment: the hardest impact, else the most contacts.
    event
        Its name; the close-up view shows its bodies.
    bodies
        The bodies of the close-up view, by numbers or names with a comma between them.
    plot
        Quantities of bodies to plot, such as ``top.z,top.omega``.
    colour_by
        What colours the bodies; by default as the scene says.

    Raises
    ------
    RecordingError
        If both a time and an event are given.
    """

    at: float | None = None
    event: str | None = None
    bodies: str | None = None
    plot: str | None = None
    colour_by: str | None = None

    def __post_init__(self) -> None:
        """Refuse two moments."""
        if self.at is not None and self.event is not None:
            raise RecordingError("give a time (at) or an event, not both")
