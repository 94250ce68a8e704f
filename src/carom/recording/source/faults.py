"""What the audit of another engine finds: broken laws, and what contacts did."""

from __future__ import annotations

from dataclasses import dataclass, field, fields

from carom.errors import RecordingError
from carom.event import Event


@dataclass(frozen=True, slots=True)
class Tolerances:
    """How much may be wrong before a law counts as broken."""

    energy: float = 1e-3  # of the energy of the cluster, between two frames
    drift: float = 1e-2  # of the energy scale, since the start
    momentum: float = 1e-3  # of Σ m |v| of the cluster
    angular_momentum: float = 1e-3  # of Σ (m |x| |v| + I |ω|) of the cluster
    overlap: float = 0.05  # of the smaller radius

    def __post_init__(self) -> None:
        for each in fields(self):
            value = getattr(self, each.name)
            if not value >= 0.0:  # NaN would find nothing
                raise RecordingError(f"the tolerance {each.name} is {value}; it must be 0 or more")


@dataclass(frozen=True, slots=True)
class Fault:
    """A broken law: "energy", "momentum", "angular-momentum", "overlap", "missed-impact" or "not-finite"."""

    law: str
    step: int
    time: float  # s
    amount: float  # in units of the law's scale
    text: str  # a sentence
    bodies: tuple[int, ...] = ()  # from n on planes

    @property
    def event(self) -> Event:
        """The fault as a line of the log."""
        return Event(self.step, self.time, "WARN", self.text, f"law-{self.law}")


@dataclass(slots=True)
class Finding:
    """What the audit of one frame found."""

    faults: list[Fault] = field(default_factory=list)
    taken: float = 0.0  # J, by contacts; negative where they gave some back
    unjudged: float = 0.0  # J, that clusters with a body that is not judged lost, to whatever
    struck: float = 0.0  # J, Σ ½ μ v_n² of the contacts that reversed
    impacts: int = 0  # how many did
    hardest: float = 0.0  # J
    hardest_pair: tuple[int, int] = (0, 0)
