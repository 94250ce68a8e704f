"""The worst of the frames of a run: where its energy rose most and its momenta were furthest off; and the last."""

from __future__ import annotations

from dataclasses import dataclass, field

from carom.physics.frame import Frame
from carom.physics.moments import Moment


def _nothing() -> Moment:
    return Moment(0.0, 0, 0.0)


@dataclass(slots=True)
class WorstFrames:
    """Extremes over the frames handed out so far.

    Contacts dissipate and gravity is conservative, so the total energy can only fall. What it rises by, from its lowest
    value on, is somebody's fault, whether the ledger has an entry for it or not.
    """

    energy_gain: Moment = field(default_factory=_nothing)  # over the energy scale
    momentum: Moment = field(default_factory=_nothing)
    angular_momentum: Moment = field(default_factory=_nothing)
    final_kinetic: Moment = field(default_factory=_nothing)  # of the last frame, over the energy scale
    _lowest: float = float("inf")  # J

    def see(self, frame: Frame) -> None:
        """Take note of a frame."""
        self._lowest = min(self._lowest, frame.energy.total)
        scale = frame.energy.scale
        gain = (frame.energy.total - self._lowest) / scale if scale > 0.0 else 0.0
        self.energy_gain = _worse(self.energy_gain, gain, frame)
        kinetic = frame.energy.translational + frame.energy.rotational
        self.final_kinetic = Moment(kinetic / scale if scale > 0.0 else 0.0, frame.step, frame.time)
        self.momentum = _worse(self.momentum, frame.momentum_error or 0.0, frame)
        self.angular_momentum = _worse(self.angular_momentum, frame.angular_momentum_error or 0.0, frame)


def _worse(known: Moment, value: float, frame: Frame) -> Moment:
    return Moment(value, frame.step, frame.time) if value > known.value else known
