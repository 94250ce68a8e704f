"""Bodies of a recording by their numbers or names, and the names of its bodies, planes and walls."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

from carom.errors import RecordingError, SceneError
from carom.recording.read.recorded_scene import recorded_scene
from carom.scene.start import names_of_solids
from carom.scene.wording import Names, bodies_called, body_called

if TYPE_CHECKING:
    from carom.recording.read.recording import Recording


_MOST_NAMED = 8  # bodies that a message lists


def body_number(recording: Recording, body: int | str) -> int:
    """Return the number of a body.

    Parameters
    ----------
    recording
        The recording.
    body
        The number, the name, or the number as text, such as "3"; "#3" if another body has the name "3".

    Raises
    ------
    RecordingError
        If there is no such body, or several have this name.
    """
    names, text = recording.bodies.name, str(body)
    if isinstance(body, str):
        found = [number for number, name in enumerate(names) if name == body]
        if len(found) > 1:
            such = _asked_for(found[0], names)
            raise RecordingError(
                f'{recording.path} has {len(found)} bodies called "{body}"; give a number, such as {such}'
            )
        if found:
            return found[0]
    number = text.removeprefix("#")
    if number.isascii() and number.isdigit() and int(number) < len(names):
        return int(number)
    raise RecordingError(f'{recording.path} has no body "{body}"; {_others(text, names)}')


def _asked_for(number: int, names: Sequence[str]) -> str:
    """Return the text that selects a body by its number in `body_number`."""
    return f'"#{number}"' if str(number) in names else str(number)


def shown_body(recording: Recording, body: int | str) -> int:
    """Return the number of a body that the recording shows; see `body_number`.

    Raises
    ------
    RecordingError
        If there is no such body, several have this name, or a clip does not show the body.
    """
    number, names, shown = body_number(recording, body), recording.bodies.name, recording.shown
    if number not in shown:
        raise RecordingError(
            f"{recording.path} does not contain {body_called(number, names[number])}: it is a clip of "
            f"{bodies_called(shown, names)}"
        )
    return number


def split_at_commas(text: str, names: Iterable[str]) -> list[str]:
    """Split a text at its commas, except within a name."""
    whole = {name for name in names if "," in name}
    most = max((name.count(",") + 1 for name in whole), default=1)
    pieces, parts = text.split(","), []
    while pieces:
        joined = [",".join(pieces[:count]).strip() for count in range(min(most, len(pieces)), 1, -1)]
        parts.append(next((name for name in joined if name in whole), pieces[0].strip()))
        del pieces[: parts[-1].count(",") + 1]
    return parts


def _begun(text: str, names: Iterable[str]) -> list[str]:
    """Return the names that start with a text; none if the text is a number, which selects a body."""
    if not text or text.isdigit():
        return []
    return [name for name in names if name.casefold().startswith(text.casefold())]


def _others(text: str, names: Sequence[str]) -> str:
    """List the bodies, and suggest the nearest name."""
    count = f"its bodies are 0 to {len(names) - 1}" if len(names) > 1 else "its only body is 0"
    own = [name for number, name in enumerate(names) if name not in ("", f"body {number}")]
    near = difflib.get_close_matches(text, own, n=1, cutoff=0.6) or _begun(text, own)
    if near:
        return f'did you mean "{near[0]}"? {count[0].upper()}{count[1:]}'
    quoted = ", ".join(f'"{name}"' for name in own)
    called = f", called {quoted}" if own and len(names) <= _MOST_NAMED else ""
    return count + called


def names_of(recording: Recording) -> Names:
    """Return the names of all bodies, planes and walls; planes are unnamed if this version cannot read the scene."""
    if recording.engine:
        return Names(recording.bodies.name, str(recording.info.get("plane_names", "")).split("\n"))
    try:
        planes = names_of_solids(recorded_scene(recording))
    except (RecordingError, SceneError):
        planes = []
    return Names(recording.bodies.name, planes)
