"""Broken laws of another engine, before and after they are reported, and the errors that break no law."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from carom.errors import RecordingError
from carom.event import Event

FRICTION, RESTITUTION, PULL, SPIN = "friction", "restitution", "pull", "spin"

# for laws that are judged over a whole run
MOSTLY = 0.75  # fraction of an engine's contacts that must agree; the other contacts may show faults
# Smallest deviation of a fault, in multiples of the deviation of most contacts: at PyBullet's planes, impulses deviate
# by as much as the coefficients.
SPREADS = 6.0


@dataclass(frozen=True, slots=True)
class Tolerances:
    """Largest errors that do not violate a law."""

    energy: float = 1e-3  # relative change of a cluster's energy between two frames
    drift: float = 1e-2  # change of the total energy since the start, over the energy scale
    momentum: float = 1e-3  # change of a cluster's momentum, over its Σ m |v|
    angular_momentum: float = 1e-3  # change of a cluster's angular momentum, over its Σ (m |x| |v| + I |ω|)
    overlap: float = np.inf  # overlap over the smaller radius; unlimited by default, since an overlap breaks no law
    restitution: float = 0.02  # error of a coefficient of restitution
    friction: float = 0.2  # part of the work of friction that may have the wrong sign

    def __post_init__(self) -> None:
        for each in fields(self):
            value = getattr(self, each.name)
            if not value >= 0.0:  # NaN would accept everything
                raise RecordingError(f"the tolerance {each.name} is {value}; it must be 0 or more")


@dataclass(frozen=True, slots=True)
class Fault:
    """A violated law.

    The law is "energy", "momentum", "angular-momentum", "overlap", "missed-impact", "friction", "restitution", "pull",
    "spin" or "not-finite".
    """

    law: str
    step: int
    time: float  # s
    amount: float  # error in units of the law's scale
    text: str  # a sentence
    bodies: tuple[int, ...] = ()  # numbers of n and above are planes
    excess: float = 1.0  # violation over tolerance

    @property
    def event(self) -> Event:
        """The fault as a line of the log."""
        return Event(self.step, self.time, "WARN", self.text, f"law-{self.law}")


@dataclass(frozen=True, slots=True)
class Broken:
    """A law that a contact broke, not yet reported."""

    law: str
    excess: float  # violation over tolerance
    ends: tuple[int, ...]
    what: str  # predicate of a sentence about the ends


BrokenThen = tuple[int, float, Broken]  # broken law with its step and its time in s
