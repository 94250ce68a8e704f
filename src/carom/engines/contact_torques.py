"""The spins that contacts change, compared over a whole run with the impulses of these contacts.

A contact of spheres changes a spin by r n × J / I. Engines differ in the normal and in the arm that they use, and a
resistance to rolling adds a torque. At the end of a run, the normal and the arm that explain most torques of the engine
are known, and also how well they explain the torques. A contact whose torque is far from this explanation breaks the
law. All contacts of an engine break the law if together they show another moment of inertia, or show spins that are in
the bodies' frames.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from carom.arrays import FloatArray
from carom.engines.engine_contacts import lengths
from carom.engines.faults import MOSTLY, SPIN, SPREADS, Broken, BrokenThen

FEWEST = 8  # smallest number of torques that show an engine's habit
RUBBED = 0.05  # smallest compared torque, divided by the impulse times its arm
CLEAR = 20.0  # smallest clear torque, in multiples of the noise of an impulse
OFF = 0.05  # smallest deviation of a fault, divided by the torque
# smallest deviation of a fault, divided by the torque, if another frame or inertia explains the whole run
SURELY = 0.01
# single torques are judged if the relative deviation of most torques is at most this; with Box3D it is 0.08
EXACT = 0.02
BETTER = 4.0  # factor by which another frame or inertia must reduce the deviations
MOST_SAMPLES = 100_000  # torques kept for comparison


@dataclass(frozen=True, slots=True)
class ContactTorque:
    """The change of a body's angular momentum in a frame, and the torques that its contacts may have had."""

    step: int
    time: float  # s
    body: int
    change: FloatArray  # (3,) N m s, change of the angular momentum, I Δω
    turned: FloatArray | None  # (3,) N m s, I Δω if spins are in body frames; None if orientations are unknown
    ways: FloatArray  # (w, 3) N m s, torques by impulses with each normal and each arm
    rolls: bool  # whether a resistance to rolling could explain the difference


@dataclass(slots=True)
class ContactTorques:
    """The torques of a run."""

    samples: list[ContactTorque] = field(default_factory=list)

    def add(self, sample: ContactTorque, largest: float, noise: float) -> None:
        """Keep a torque above the noise (N m s) that is not small beside the largest torque that its impulses allow."""
        size = float(lengths(sample.ways).min())
        if size > max(RUBBED * largest, CLEAR * noise) and len(self.samples) < MOST_SAMPLES:
            self.samples.append(sample)

    def concluded(self) -> Iterator[BrokenThen]:
        """Yield the torques that break the law, judged by all torques of the run."""
        if len(self.samples) < FEWEST:
            return
        ways = np.array([sample.ways for sample in self.samples])
        seen = np.array([sample.change for sample in self.samples])
        _, off = _usual_way(ways, seen)
        usual = float(np.quantile(off, MOSTLY))
        turned = [sample.turned for sample in self.samples if sample.turned is not None]
        if len(turned) == len(seen):
            way, off_there = _usual_way(ways, np.array(turned))
            beside = float(np.quantile(off_there, MOSTLY))
            if BETTER * beside < min(OFF, usual):
                what = "changes its spin as if spins were given in the frame of the body"
                yield from self._above(_off(ways[:, way], seen), max(SURELY, SPREADS * beside), what)
                return
        ratios = np.einsum("mi,mwi->mw", seen, ways) / np.einsum("mwi,mwi->mw", ways, ways)
        way, off_then = _usual_way(np.median(ratios, axis=0)[:, None] * ways, seen)
        ratio, beside = float(np.median(ratios[:, way])), float(np.quantile(off_then, MOSTLY))
        if abs(ratio - 1.0) > max(2.0 * OFF, BETTER * beside):
            what = f"changes its spin, like other bodies, by {ratio:.3g} times what its contacts explain"
            yield from self._above(_off(ways[:, way], seen), max(SURELY, SPREADS * beside), what)
            return
        if usual < EXACT:
            yield from self._above(
                off, max(OFF, SPREADS * usual), "changes its spin in another way than its contacts would"
            )

    def _above(self, off: FloatArray, allowed: float, what: str) -> Iterator[BrokenThen]:
        """Yield the torques whose deviations exceed the allowed deviation.

        If every torque on a body deviates, a torque that may be a resistance to rolling counts as such.
        """
        wrong = off > allowed
        right = {sample.body for sample, each in zip(self.samples, wrong, strict=True) if not each}
        for k in np.flatnonzero(wrong).tolist():
            sample = self.samples[k]
            if sample.body in right or not sample.rolls:
                by = f"; off by {off[k]:.0%} of their torque"
                yield sample.step, sample.time, Broken(SPIN, float(off[k]) / allowed, (sample.body,), what + by)


def _usual_way(ways: FloatArray, seen: FloatArray) -> tuple[int, FloatArray]:
    """Return the column of ``ways`` (m, w, 3) that explains most torques, and the deviations from that column, (m,)."""
    off = np.stack([_off(ways[:, way], seen) for way in range(ways.shape[1])])
    best = int(np.argmin(np.quantile(off, MOSTLY, axis=1)))
    return best, off[best]


def _off(expected: FloatArray, seen: FloatArray) -> FloatArray:
    """Return the deviations (m,) of torques (m, 3), relative to the expected torques."""
    return np.asarray(lengths(seen - expected) / lengths(expected))
