"""`Account`: the velocity of a body as the sum of its start velocity, impulses of contacts, and forces.

`chain_of` finds the strongest path back through its causes.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from carom.arrays import BoolArray, FloatArray, Records
from carom.lab.why.cone import Cone, Flow, Passage
from carom.lab.why.history import History, Step

_AT_REST = 1e-3  # largest speed of a body at rest, relative to the sum of |J|/m that holds the body in a step

# The chain of causes: the strongest path back from the bodies of the question.
MOST_LINKS = 50
_WEAKEST = 0.1  # fraction of the share that led to a body; if every impact has less, the body's own motion is the cause
_AT_ONCE = 0.5  # weight of an impact at the same instant as the impact after it, since their order is unknown


@dataclass(slots=True)
class Cause:
    """An impact, a stop, or a contact that held for some steps in a row.

    A stop is an impact whose contact closed no faster than the rest speed (docs/physics.md, 9).
    """

    partner: int  # other end of the contact with this body; numbers ≥ n are planes and walls
    holds: bool  # whether the cause is a contact at rest
    first: float  # s, time of the first step
    last: float  # s, time of the last step; equal to `first` for an impact
    step: int  # number of the last step
    impulse: FloatArray  # (3,) N s, impulse on the body
    size: float  # N s, Σ |J|
    work: float  # J, work on the motion of the body's centre
    moment: float  # s, time of the impact, or of the largest impulse
    hardest: float  # N s, largest impulse in a step
    approach_speed: float | None = None  # m/s, closing speed of an impact
    energy_lost: float | None = 0.0  # J, energy that restitution and friction dissipated; None if unknown
    lasts: bool = False  # whether an impact is a force that lasts for some steps, like impacts in other engines
    share: float = 0.0  # net fraction of the velocity that the other end gave; see `Cone`
    # fraction of the velocity that the other end turned round without giving speed: a plane, a wall or a fixed body
    turned: float = 0.0

    @property
    def kind(self) -> str:
        """The kind of cause: "impact", "stop" or "contact"."""
        if self.holds:
            return "contact"
        return "stop" if self.approach_speed is None else "impact"

    def takes(self, earlier: Cause, adjoins: bool) -> bool:
        """Return whether this contact continues an earlier one; ``adjoins``: whether that is in the previous step."""
        goes_on = self.holds or (self.lasts and earlier.lasts)
        return adjoins and goes_on and earlier.holds == self.holds and earlier.partner == self.partner

    def join(self, earlier: Cause) -> None:
        """Add the impulses of an earlier part of the same cause."""
        self.first, self.impulse = earlier.first, self.impulse + earlier.impulse
        self.size, self.work = self.size + earlier.size, self.work + earlier.work
        self.share, self.turned = self.share + earlier.share, self.turned + earlier.turned
        if self.energy_lost is not None and earlier.energy_lost is not None:
            self.energy_lost += earlier.energy_lost
        if earlier.approach_speed is not None:
            self.approach_speed = max(self.approach_speed or 0.0, earlier.approach_speed)
        if earlier.hardest > self.hardest:
            self.hardest, self.moment = earlier.hardest, earlier.moment


@dataclass(slots=True)
class Account:
    """The sources of a body's velocity since the beginning of a window.

    velocity = start_velocity + by_contacts + by_forces, up to rounding. Shares are defined by `Cone`: start_share +
    forces_share + Σ share of the causes = 1.
    """

    body: int
    mass: float  # kg
    velocity: FloatArray  # (3,) m/s, velocity at the chosen moment
    start_velocity: FloatArray  # (3,) m/s, velocity at the beginning of the window
    by_contacts: FloatArray  # (3,) m/s, Σ J / m
    by_forces: FloatArray  # (3,) m/s, change of velocity by forces
    by_field: FloatArray  # (3,) m/s, the part of `by_forces` that the uniform field of another engine gave
    fastest: float  # m/s, the largest speed or change of velocity in the account
    start_share: float = 1.0  # share of the velocity that the body had at the beginning
    forces_share: float = 0.0  # share of the velocity that forces on the body gave
    field_share: float = 0.0  # the part of `forces_share` that the uniform field of another engine gave
    causes: list[Cause] = field(default_factory=list)  # causes, the latest first
    _bearing: float | None = None  # m/s, Σ |J| / m over the contacts that held the body in the last step
    # the contact with each partner, and the step before that contact began
    _held: dict[int, tuple[Cause, int]] = field(default_factory=dict)
    # J, energy lost in the step with each partner, without impacts
    _lost: dict[int, float] = field(default_factory=dict)
    _before: int = 0  # the step before the present step

    @classmethod
    def at(cls, body: int, mass: float, velocity: FloatArray) -> Account:
        """Begin with the velocity at the moment of the question."""
        speed, (contacts, forces, field) = float(np.linalg.norm(velocity)), np.zeros((3, 3))
        return cls(body, mass, velocity.copy(), velocity.copy(), contacts, forces, field, speed)

    @property
    def unexplained(self) -> float:
        """The unexplained part of the velocity, relative to the largest speed or change of velocity in the account."""
        rest = self.velocity - self.start_velocity - self.by_contacts - self.by_forces
        return float(np.linalg.norm(rest)) / self.fastest if self.fastest > 0.0 else 0.0

    @property
    def rests(self) -> bool:
        """Whether contacts hold the body still: its speed is below a thousandth of Σ |J| / m."""
        return bool(np.linalg.norm(self.velocity) <= _AT_REST * (self._bearing or -1.0))

    @property
    def largest(self) -> list[Cause]:
        """The causes, the largest share first; for a body at rest, the largest impulse first."""
        return sorted(self.causes, key=lambda cause: -(cause.size if self.rests else cause.share))

    def share_of(self, *kinds: str) -> float:
        """Return the share of the velocity that each kind of cause contributes."""
        return sum(cause.share for cause in self.causes if cause.kind in kinds)

    def take(
        self,
        step: Step,
        rows: Records,
        flow: Flow,
        shares: tuple[float, float, float],
        kicks: list[FloatArray],
        impacts: Records,
        contacts: Records,
    ) -> None:
        """Go back through a whole step, or through the part of it before a moment.

        ``rows`` are the impulses on this body up to the moment, in order, and ``flow``, (k, 1), are their shares of the
        body's velocity. ``shares`` has three numbers: the share that the body carries before the step, the share from
        forces so far, and the part of the force share that comes from another engine's uniform field. ``kicks`` are the
        body's changes of velocity by forces, (3,) m/s each. ``impacts`` and ``contacts`` are the `CONTACT_ROW` of the
        step, if the step is whole; its beginning alone has no contacts.
        """
        self._lost, self._before = {}, step.before_step  # losses of all contacts, minus losses of impacts
        for some, sign in ((contacts, 1.0), (impacts, -1.0)) if len(contacts) else ():
            for row in some[_acts_on(self.body, some)]:
                self._lost[self._other(row)] = self._lost.get(self._other(row), 0.0) + sign * _loss(row)
        if self._bearing is None:
            self._bearing = float(np.linalg.norm(self._impulses(rows[rows["holds"]]), axis=1).sum()) / self.mass
        first, last = sum(kicks[:1], np.zeros(3)), sum(kicks[1:], np.zeros(3))  # kicks before and after the drift
        self.start_share, self.forces_share, self.field_share = shares
        late = len(rows) > 0 and rows[-1]["time"] >= step.time
        # the velocity right after the last impulse
        kicked = first + last if late else first
        now: FloatArray = step.before[self.body] + kicked + self._impulses(rows).sum(axis=0) / self.mass
        keys = list(zip(rows["instant"].tolist(), (rows["holds"] | rows["lasts"]).tolist(), strict=True))
        given = np.concatenate((flow.net, flow.turned), axis=1)
        end = len(rows)
        while end > 0:
            if late and rows[end - 1]["time"] < step.time:
                now, late = now - last, False
            begin = end - 1
            while begin > 0 and keys[begin - 1] == keys[end - 1]:
                begin -= 1
            now = self._undo(rows[begin:end], given[begin:end], now, last if late else first, impacts)
            end = begin
        self.by_forces, self.by_field = self.by_forces + first + last, self.by_field + step.by_field
        self.start_velocity = step.before[self.body].copy()

    def _impulses(self, rows: Records) -> FloatArray:
        """Return the impulses on this body, (k, 3) N s."""
        impulses = np.stack([rows["x"], rows["y"], rows["z"]], axis=1)
        impulses[rows["i"] == self.body] *= -1.0
        return impulses

    def _other(self, row: np.void) -> int:
        """Return the other end of a contact."""
        return int(row["i"]) if row["j"] == self.body else int(row["j"])

    def _undo(
        self, rows: Records, flow: FloatArray, after: FloatArray, kick: FloatArray, impacts: Records
    ) -> FloatArray:
        """Undo impulses that act together, given their net and turned shares, (k, 2); return the velocity before them.

        Contacts at rest and lasting contacts cancel a ``kick``, (3,) m/s, of the forces. The work of contacts is
        computed with the mean velocity without this kick, so that the normal force of a floor does no work on a sliding
        ball.
        """
        impulses = self._impulses(rows)
        sizes = np.sqrt((impulses * impulses).sum(axis=1))
        change = impulses.sum(axis=0) / self.mass
        before: FloatArray = after - change
        self.by_contacts = self.by_contacts + change
        given, had = float(sizes.sum()) / self.mass, float(np.linalg.norm(before))
        self.fastest = max(self.fastest, given, had)
        for row, impulse, size, shares in zip(rows, impulses, sizes.tolist(), flow.tolist(), strict=True):
            if size > 0.0:
                mean = 0.5 * (after + before - (kick if row["holds"] or row["lasts"] else 0.0))
                self._add(row, impulse, size, float(impulse @ mean), shares, impacts)
        return before

    def _add(
        self, row: np.void, impulse: FloatArray, size: float, work: float, shares: list[float], impacts: Records
    ) -> None:
        partner, time, step = self._other(row), float(row["time"]), int(row["step"])
        holds, lasts = bool(row["holds"]), bool(row["lasts"])
        cause = Cause(partner, holds, time, time, step, impulse, size, work, time, size, lasts=lasts)
        cause.share, cause.turned = shares
        if not holds:
            # approach speed and energy loss come from the recorded impact
            low, high = sorted((self.body, partner))
            own = impacts[(impacts["i"] == low) & (impacts["j"] == high) & (impacts["time"] == time)]
            if len(own):  # a pair may meet several times at one moment
                squares = (own[name] ** 2 for name in ("normal_impulse", "friction_x", "friction_y", "friction_z"))
                met = own[int(np.argmin(np.abs(np.asarray(np.sqrt(sum(squares))) - size)))]
                cause.approach_speed, cause.energy_lost = float(met["approach_speed"]), _loss(met)
        if lasts:
            cause.energy_lost = None
        elif cause.kind != "impact":  # the loss of the whole step belongs to the last cause in the step
            cause.energy_lost = self._lost.pop(partner, 0.0)
        known = self._held.get(partner)
        if known is not None and known[0].takes(cause, step >= known[1]):
            known[0].join(cause)
            self._held[partner] = known[0], self._before
            return
        if holds or lasts:
            self._held[partner] = cause, self._before
        self.causes.append(cause)


def _loss(row: np.void) -> float:
    """Return the energy (J) that a contact dissipated."""
    return float(row["restitution_loss"] + row["friction_loss"])


def _acts_on(body: int, rows: Records) -> BoolArray:
    """Return a mask of the impulses on a body."""
    return np.asarray((rows["i"] == body) | (rows["j"] == body))


def impulses_on(body: int, rows: Records, flow: Flow, place: int) -> tuple[Records, Flow]:
    """Return the impulses on a body, and their shares of its velocity (a column of the flow), (k, 1)."""
    own = _acts_on(body, rows)
    found: Records = rows[own]
    sign = np.where(found["i"] == body, 1.0, -1.0)[:, None]
    column = slice(place, place + 1)
    return found, Flow(sign * flow.net[own, column], flow.turned[own, column])


def impacts_by_step(history: History) -> dict[int, Records]:
    """Return the impacts of a window by their steps."""
    impacts = history.impacts
    steps, first = np.unique(impacts["step"], return_index=True)
    return dict(zip(steps.tolist(), np.split(impacts, first[1:]), strict=True)) if len(impacts) else {}


@dataclass(frozen=True, slots=True)
class Link:
    """An impact that gave a body its velocity, or in which an end at rest turned the body round."""

    step: int
    instant: int  # number of the instant within the step; impacts of one instant act together
    time: float  # s
    body: int
    by: int  # the end that acted; numbers ≥ n are planes and walls
    impulse: float  # N s
    share: float  # share of the answer that passed from `by` to `body`
    turned: float = 0.0  # share of the answer that `by` turned round without giving speed
    turns: bool = False  # whether the impact is in the chain because it turned the body round


def chain_of(cone: Cone, bodies: tuple[int, ...]) -> list[Link]:
    """Return the impacts of the chain, the latest first; none if no impact passed on a tenth of the answer.

    From each body, the chain follows the earlier impact with the largest share of the answer, until the body's own
    motion has a larger share. Impacts in between that turned the body round are also links; they lead back to the
    motion of the same body.
    """
    left = list(cone.passages)
    links: list[Link] = []
    current, share, followed = set(bodies), 1.0, 0
    while followed < MOST_LINKS:
        earlier = [(place, link) for place, p in enumerate(left) for link in _links_to(current, p)]
        place, found = max(earlier, key=lambda each: each[1].share, default=(0, None))
        least = _AT_ONCE if found and followed and _moment(found) == _moment(links[-1]) else _WEAKEST
        if found is not None and found.share < least * share:
            found = None
        turns = [
            replace(link, turns=True)
            for number, link in earlier
            if link.turned >= _WEAKEST * share and (found is None or (link.body == found.body and number < place))
        ]
        if found is None and turns:  # if the question names two bodies, turns of only one of them count
            body = max(turns, key=lambda link: link.turned).body
            turns = [link for link in turns if link.body == body]
        links += turns
        if found is None:
            break
        links.append(found)
        if found.by >= cone.count:  # a wall that moves on its own
            break
        followed, current, share = followed + 1, {found.by}, found.share
        left = [p for number, p in enumerate(left) if _moment(p) <= _moment(found) and number != place]
    return links


def _links_to(bodies: set[int], passage: Passage) -> Iterator[Link]:
    """Yield an impact as a link to each end that is among the given bodies."""
    for body, by, net in ((passage.i, passage.j, passage.net), (passage.j, passage.i, -passage.net)):
        if body in bodies:
            at = passage.step, passage.instant, passage.time
            yield Link(*at, body, by, passage.impulse, net, passage.turned)


def _moment(impact: Passage | Link) -> tuple[int, int]:
    return impact.step, impact.instant
