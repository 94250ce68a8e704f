"""The chain of causes: the strongest way back from the bodies asked about."""

from __future__ import annotations

from dataclasses import dataclass

from carom.lab.why.cone import Cone, Passage

MOST_LINKS = 50
_WEAKEST = 0.1  # of the share that led to a body, below which what it had by itself is the cause
_AT_ONCE = 0.5  # likewise, for another impact at the same instant: nothing says which of them was first


@dataclass(frozen=True, slots=True)
class Link:
    """An impact by which one body got its velocity from another."""

    step: int
    time: float  # s
    body: int
    by: int
    impulse: float  # N s
    share: float  # of the answer, that passed


def chain_of(cone: Cone, bodies: tuple[int, ...]) -> list[Link]:
    """Return the impacts of the chain, the latest first.

    From each body it goes back over the impact that most of the answer passed, among those before, until what the body
    had without them is more. There is none if no impact passed on a tenth of the answer.
    """
    left = list(cone.passages)
    links: list[Link] = []
    current, share = set(bodies), 1.0
    while len(links) < MOST_LINKS:
        chosen, link = _strongest(left, current)
        if link is None:
            break
        if link.share < share * (_AT_ONCE if links and link.time == links[-1].time else _WEAKEST):
            break
        links.append(link)
        current, share = {link.by}, link.share
        left = [passage for passage in left if passage.time <= link.time and passage is not chosen]
    return links


def _strongest(passages: list[Passage], bodies: set[int]) -> tuple[Passage | None, Link | None]:
    chosen: Passage | None = None
    best: Link | None = None
    for passage in passages:
        for body, by, share in ((passage.i, passage.j, passage.to_i), (passage.j, passage.i, passage.to_j)):
            if body in bodies and (share > (best.share if best else 0.0)):
                chosen, best = passage, Link(passage.step, passage.time, body, by, passage.impulse, share)
    return chosen, best
