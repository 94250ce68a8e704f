"""`Pair`: the two ends of the contact in the close-up view, and how it is chosen."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from carom.physics.frame import Frame
from carom.recording.errors import RecordingError
from carom.recording.read.body_names import body_number, split_at_commas
from carom.recording.read.impacts import numbered_impact
from carom.recording.read.recording import Recording
from carom.recording.schema.timelines import SIM_TIME, STEP
from carom.scene.names import bodies_called, body_called

_IMPACT = "impact:"  # before the number of an impact
_DIGITS = 18  # so many fit into 64 bits


@dataclass(frozen=True, slots=True)
class Pair:
    """Two ends of a contact."""

    i: int
    j: int | None  # None if i touches a plane or a wall
    plane: int | None = None  # number of that plane or wall


def named_pair(recording: Recording, text: str) -> Pair:
    """Read two bodies from numbers or names with a comma between them.

    Raises
    ------
    RecordingError
        If they are not two bodies of the recording.
    """
    given = split_at_commas(text, recording.bodies.name)
    if len(given) != 2 or not all(given):
        raise RecordingError(f"bodies {text}: expected two bodies with a comma between them, such as 0,1")
    first, second = (body_number(recording, part) for part in given)
    if first == second:
        raise RecordingError(f"bodies {text}: this is one body; give two")
    for body in (first, second):
        if body not in recording.shown:
            names = recording.bodies.name
            raise RecordingError(
                f"{recording.path} does not show {body_called(body, names[body])}: "
                f"it is a clip of {bodies_called(recording.shown, names)}"
            )
    return Pair(min(first, second), max(first, second))


def hardest_pair(recording: Recording) -> Pair | None:
    """Return the pair of the run's hardest impact; None if none is recorded."""
    return _pair(recording, dict(recording.closing), "moments.impact.")


def pair_of_step(frame: Frame, bodies: int) -> Pair | None:
    """Return the ends of the contact with the largest impulse (if unknown, of the first); None without contacts."""
    graph = frame.contacts
    if not len(graph):
        return None
    rows = frame.contact_rows
    row = graph.first if rows is None or len(rows) != len(graph) else int(np.argmax(rows["normal_impulse"]))
    i, j = (int(end) for end in graph.pairs[row])
    return Pair(i, j) if j < bodies else Pair(i, None, j - bodies)


def event(recording: Recording, name: str) -> tuple[float, Pair | None]:
    """Return the time (s) and the bodies of an event.

    Parameters
    ----------
    name
        An extreme of `carom inspect`, a kind of event, of which the first is taken, or ``impact:N``, the Nth impact.

    Raises
    ------
    RecordingError
        If there is no such event.
    """
    if name.startswith(_IMPACT):
        return _impact(recording, name.removeprefix(_IMPACT))
    closing = dict(recording.closing)
    if f"moments.{name}.time" in closing:
        return float(closing[f"moments.{name}.time"]), _pair(recording, closing, f"moments.{name}.")
    table = recording.events()
    kinds = table["kind"].to_pylist()
    if name in kinds:
        row = kinds.index(name)
        frames = recording.fingerprints()
        steps = frames[STEP].to_numpy()
        own = np.flatnonzero(steps == table[STEP][row].as_py())
        if len(own):
            return float(frames["time"][int(own[0])].as_py()), None
        scale = float(recording.info["time_scale"])
        return float(table[SIM_TIME][row].value) * 1e-9 * scale, None
    moments = sorted({key.split(".")[1] for key in closing if key.startswith("moments.") and key.endswith(".time")})
    known = dict.fromkeys([*moments, *(kind for kind in kinds if kind not in ("", "extreme", "end"))])
    has = f"it has {', '.join(known)}" if known else "it has none"
    raise RecordingError(f'{recording.path} has no event "{name}"; {has}')


def _impact(recording: Recording, text: str) -> tuple[float, Pair]:
    """Return the time (s) and the ends of an impact, given its number on the timeline ``impact``."""
    if not text.isdigit() or len(text) > _DIGITS:
        raise RecordingError(f"event {_IMPACT}{text}: expected the number of an impact, such as {_IMPACT}3")
    at, i, j = numbered_impact(recording, int(text))
    bodies = int(recording.info["bodies"])
    return at, Pair(i, j) if j < bodies else Pair(i, None, j - bodies)


def _pair(recording: Recording, closing: dict[str, Any], prefix: str) -> Pair | None:
    found, planes = (_numbers(closing.get(f"{prefix}{what}", "")) for what in ("bodies", "planes"))
    shown = set(recording.shown)
    if not found or not all(body in shown for body in found):
        return None
    if len(found) > 1:
        return Pair(found[0], found[1])
    return Pair(found[0], None, planes[0] if planes else None)


def _numbers(text: object) -> list[int]:
    return [int(part) for part in str(text).split(",") if part.strip().isdigit()]
