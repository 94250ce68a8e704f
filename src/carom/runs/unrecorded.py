"""Notes on everything that a recorder could not record: events of the recording, and lines on stderr."""

from __future__ import annotations

import contextlib
import sys
import threading
from pathlib import Path

from carom.errors import RecordingError
from carom.event import Event
from carom.scene.wording import counted

KIND = "not-recorded"  # of the events
MOST_TEXTS = 20  # further texts are only counted


class Unrecorded:
    """Notes on states and contacts that could not be recorded. Any thread may add notes.

    Parameters
    ----------
    path
        The recording, for the lines on stderr.
    """

    def __init__(self, path: Path) -> None:
        self.events: list[Event] = []  # only ever appended to
        self.texts: list[str] = []
        self.count = 0
        self._path = path
        self._known: set[str] = set()
        self._lock = threading.Lock()

    def add(self, step: int, time: float, problem: Exception | str, consequence: str, *, ends: bool = False) -> None:
        """Add a note on a problem and its consequence; a text that differs only in its digits is counted, not repeated.

        A problem that ends the recording is not an event, since the outcome states it.
        """
        cause = problem if isinstance(problem, str) else sentence_of(problem)
        pattern, text = "".join(letter for letter in cause if not letter.isdigit()), f"{cause} {consequence}"
        with self._lock:
            self.count += 1
            if pattern in self._known or len(self._known) == MOST_TEXTS:
                return
            self._known.add(pattern)
            self.texts.append(text)
            if not ends:
                self.events.append(Event(step, time, "WARN", text, KIND))
        with contextlib.suppress(OSError, ValueError, AttributeError):  # stderr may be full, closed or missing
            sys.stderr.write(f"carom: {self._path}: {text}\n")
            sys.stderr.flush()

    def total(self, step: int, time: float) -> list[Event]:
        """Return the event that counts the problems, if there are more than texts."""
        if self.count <= len(self.texts):
            return []
        return [Event(step, time, "WARN", f"{counted(self.count, 'problem')} of recording in all.", KIND)]


def sentence_of(error: Exception) -> str:
    """Return an error as a sentence."""
    text = str(error) if isinstance(error, RecordingError) else f"{type(error).__name__}: {error}"
    return text if text.endswith((".", "!", "?")) else f"{text}."
