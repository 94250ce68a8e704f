"""`NamedEvent`: an event that is asked for by name: its time, its step and the bodies that meet."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from carom.errors import RecordingError
from carom.recording.read.impacts import numbered_impact
from carom.recording.read.recording import Recording
from carom.recording.schema.paths import SIM_TIME, STEP
from carom.show.pair import Pair, pair_of_extreme

_IMPACT = "impact:"  # before the number of an impact
_FIRST_CONTACT = "first-contact"  # a kind of event
_DIGITS = 18  # so many fit into 64 bits


@dataclass(frozen=True, slots=True)
class NamedEvent:
    """An event of a run."""

    time: float  # s
    pair: Pair | None = None  # None if it is not the meeting of two
    step: int | None = None  # of an impact: at the end of one step, it may belong to the next
    is_impact: bool = False


def named_event(recording: Recording, name: str) -> NamedEvent:
    """Find an event.

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
        time = float(closing[f"moments.{name}.time"])
        return NamedEvent(time, pair_of_extreme(recording, name), is_impact=name == "impact")
    table = recording.events()
    kinds = table["kind"].to_pylist()
    if name in kinds:
        row = kinds.index(name)
        frames = recording.fingerprints()
        steps = frames[STEP].to_numpy()
        step = table[STEP][row].as_py()
        own = np.flatnonzero(steps == step)
        pair = _first_to_meet(recording, step) if name == _FIRST_CONTACT else None
        if len(own):
            return NamedEvent(float(frames["time"][int(own[0])].as_py()), pair, is_impact=pair is not None)
        scale = float(recording.info["time_scale"])
        return NamedEvent(float(table[SIM_TIME][row].value) * 1e-9 * scale, pair, is_impact=pair is not None)
    moments = sorted({key.split(".")[1] for key in closing if key.startswith("moments.") and key.endswith(".time")})
    known = dict.fromkeys([*moments, *(kind for kind in kinds if kind not in ("", "extreme", "end"))])
    has = f"it has {', '.join(known)}" if known else "it has none"
    raise RecordingError(f'{recording.path} has no event "{name}"; {has}')


def _first_to_meet(recording: Recording, step: int) -> Pair | None:
    """Return the pair of the run's first impact, if it is recorded and happened in a step."""
    try:
        first = _impact(recording, "1")
    except RecordingError:
        return None
    return first.pair if first.step == step else None


def _impact(recording: Recording, text: str) -> NamedEvent:
    """Find an impact by its number on the timeline ``impact``."""
    if not text.isdigit() or len(text) > _DIGITS:
        raise RecordingError(f"event {_IMPACT}{text}: expected the number of an impact, such as {_IMPACT}3")
    time, step, i, j = numbered_impact(recording, int(text))
    bodies = int(recording.info["bodies"])
    return NamedEvent(time, Pair(i, j) if j < bodies else Pair(i, None, j - bodies), step, is_impact=True)
