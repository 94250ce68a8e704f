"""`Answer`: why a body moves as it does, or why two bodies touch."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from carom.lab.why.account import Account
from carom.lab.why.chain import Link
from carom.lab.why.cone import Cone, Edge
from carom.lab.why.question import Question


@dataclass(frozen=True, slots=True)
class Answer:
    """The velocities of the bodies asked about, where they come from, and what is behind that."""

    question: Question
    time: float  # s, to which the velocities belong
    step: int
    begin: float  # s, of the window
    begin_step: int
    source: str  # of the numbers, in words
    accounts: list[Account]  # of the bodies asked about
    cone: Cone
    chain: list[Link]  # the latest first

    @property
    def is_flow(self) -> bool:
        """Whether contacts hold a body still, or gave it more than impacts did: the answer is a flow of impulse."""
        return any(a.rests or a.share_of("contact", "stop") > a.share_of("impact") for a in self.accounts)

    @property
    def kind(self) -> str:
        """What is behind it most: "flow", "impacts", "forces", or "start", the velocities at the beginning."""
        if self.is_flow or self.chain:
            return "flow" if self.is_flow else "impacts"
        return "forces" if self.cone.from_forces.sum() > self.cone.shares.sum() else "start"

    @property
    def bodies(self) -> NDArray[np.int64]:
        """The bodies of the cone: only these could have had an effect, but for forces between bodies."""
        return np.flatnonzero(self.cone.reached)

    @property
    def closed(self) -> NDArray[np.int64]:
        """The cone, and the bodies that touched one of it, directly or not: without any others all would be the same.

        This holds bit for bit where no forces act between bodies and steps have a fixed length.
        """
        return np.flatnonzero(self.cone.closed())

    @property
    def edges(self) -> list[Edge]:
        """The contacts of the cone, those with the largest share first."""
        return sorted(self.cone.edges.values(), key=lambda edge: -edge.share)

    @property
    def first_cause(self) -> int:
        """The body at the beginning of the chain."""
        return self.chain[-1].by if self.chain else self.question.bodies[0]
