"""The events of a recording by their names, and the two ends of a contact."""

from __future__ import annotations

from dataclasses import dataclass

from carom.errors import RecordingError
from carom.recording.read.lookup import end_of_step, names_of, recorded_moments, shown_body, split_at_commas
from carom.recording.read.recorded_impacts import numbered_impact
from carom.recording.read.recording import Recording
from carom.recording.timelines import SIM_TIME, STEP
from carom.scene.wording import suggestion


@dataclass(frozen=True, slots=True)
class Pair:
    """Two ends of a contact."""

    i: int
    j: int | None  # the second body; None if i touches a plane or wall
    plane: int | None = None  # number of the touched plane or wall

    @property
    def bodies(self) -> tuple[int, ...]:
        """The numbers of the two bodies, or of the one body that touches a plane."""
        return (self.i,) if self.j is None else (self.i, self.j)


def named_pair(recording: Recording, text: str) -> Pair:
    """Read two bodies from numbers or names separated by a comma, or one body that touches a plane or a wall.

    Raises RecordingError unless the text names two different bodies, or one body of a recording with a plane or a wall.
    """
    given = split_at_commas(text, recording.bodies.name)
    if len(given) == 1 and given[0] and names_of(recording).planes:
        return Pair(shown_body(recording, given[0]), None)
    if len(given) != 2 or not all(given):
        raise RecordingError(f"bodies {text}: expected two bodies separated by a comma, such as 0,1")
    first, second = (shown_body(recording, part) for part in given)
    if first == second:
        raise RecordingError(f"bodies {text}: this is one body; name two")
    return Pair(min(first, second), max(first, second))


def pair_of_extreme(recording: Recording, name: str) -> Pair | None:
    """Return the pair of an extreme, such as ``impact`` (the hardest); None if it is not recorded or not shown."""
    closing = dict(recording.closing)
    texts = (str(closing.get(f"moments.{name}.{what}", "")).split(",") for what in ("bodies", "planes"))
    found, planes = ([int(part) for part in parts if part.strip().isdigit()] for parts in texts)
    shown = set(recording.shown)
    if not found or not all(body in shown for body in found):
        return None
    if len(found) > 1:
        return Pair(found[0], found[1])
    return Pair(found[0], None, planes[0] if planes else None)


_IMPACT = "impact:"  # prefix of the number of an impact
_FIRST_CONTACT = "first-contact"  # a kind of event
_DIGITS = 18  # a number with at most this many digits fits into 64 bits


@dataclass(frozen=True, slots=True)
class NamedEvent:
    """An event of a run."""

    time: float  # s
    pair: Pair | None = None  # the pair that meets; None for any other event
    step: int | None = None  # step of an impact, since an impact at the end of a step may belong to the next step
    is_impact: bool = False

    def end(self, recording: Recording) -> float:
        """Return the end (s) of the impact's step if this step has a frame; otherwise the time of the event."""
        end = None if self.step is None else end_of_step(recording, self.step)
        return self.time if end is None else end


def named_event(recording: Recording, name: str) -> NamedEvent:
    """Find an event.

    Parameters
    ----------
    name
        An extreme of `carom inspect`, a kind of event (its first occurrence), or ``impact:N``, the Nth impact.

    Raises
    ------
    RecordingError
        If there is no such event.
    """
    if name.startswith(_IMPACT):
        return _impact(recording, name.removeprefix(_IMPACT))
    moments = recorded_moments(recording)
    if name in moments:
        return NamedEvent(moments[name], pair_of_extreme(recording, name), is_impact=name == "impact")
    table = recording.events()
    kinds = table["kind"].to_pylist()
    if name in kinds:
        row = kinds.index(name)
        step = table[STEP][row].as_py()
        pair = _first_to_meet(recording, step) if name == _FIRST_CONTACT else None
        time = end_of_step(recording, step)
        if time is None:
            time = float(table[SIM_TIME][row].value) * 1e-9 * float(recording.info["time_scale"])
        return NamedEvent(time, pair, is_impact=pair is not None)
    known = dict.fromkeys([*sorted(moments), *(kind for kind in kinds if kind not in ("", "extreme", "end"))])
    raise RecordingError(f'{recording.path} has no event "{name}"; {suggestion(name, known)}')


def _first_to_meet(recording: Recording, step: int) -> Pair | None:
    """Return the pair of the run's first impact, if this impact is recorded and happened in ``step``."""
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
