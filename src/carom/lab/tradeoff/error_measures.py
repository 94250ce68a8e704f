"""The errors of a run against a reference: in space and time up to a horizon, in statistics beyond it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from carom.lab.tradeoff.trajectory import Trajectory
from carom.physics.periodic_box import minimum_images

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Errors:
    """The errors of a run; NaN if not measured. Smaller is better for each."""

    position: float  # rms over bodies and samples up to the horizon, over the size of the system
    velocity: float  # likewise, over its speed
    impact: float  # s, rms over the pairs that met before the horizon, of the time of their first contact
    missed: float  # number of those pairs that had not met by then; for `impact` they count as met at the horizon
    energy: float  # largest |integration error| over the energy scale, from the ledger
    energy_gain: float  # largest rise of the total energy above its lowest so far, over the scale
    momentum: float  # largest error of the momentum over its scale
    angular_momentum: float
    overlap: float  # deepest overlap over the smaller radius
    sinking: float  # mean overlap of contacts late in the run, likewise; NaN if nothing can rest
    impacts: float  # | number of impacts / that of the reference - 1 |
    size: float  # rms over all samples of the rms radius, over the reference's
    dispersion: float  # likewise of the rms speed about the centre


NAMES = tuple(Errors.__dataclass_fields__)
COMPARED = ("position", "velocity", "impact", "missed", "impacts", "size", "dispersion")  # with the reference


@dataclass(frozen=True, slots=True)
class Scale:
    """The units of errors in position and velocity."""

    length: float  # m, the largest rms distance from the centre, or half the box
    speed: float  # m/s, the largest rms speed about the mean velocity
    box: FloatArray | None = None  # (3,) m, of a periodic domain

    @classmethod
    def of(cls, trajectory: Trajectory, box: FloatArray | None) -> Scale:
        """Return the scale of a reference."""
        length = float(spread(trajectory.position).max()) if box is None else float(box.min()) / 2
        speed = float(spread(trajectory.velocity).max())
        length = length or float(np.abs(trajectory.position).max()) or 1.0
        return cls(length, speed or length / float(trajectory.time[-1]), box)

    def apart(self, a: Trajectory, b: Trajectory) -> tuple[FloatArray, FloatArray]:
        """Return the rms distance of two runs in position and in velocity at each common sample, over the scale."""
        count = min(len(a), len(b))
        d = a.position[:count] - b.position[:count]
        if self.box is not None:
            d = minimum_images(d, self.box)
        return _rms(d) / self.length, _rms(a.velocity[:count] - b.velocity[:count]) / self.speed


def spread(vectors: FloatArray) -> FloatArray:
    """Return the rms distance of (K, n, 3) vectors from their mean, (K,)."""
    return _rms(vectors - vectors.mean(axis=1, keepdims=True))


def compare(run: Trajectory, reference: Trajectory, scale: Scale, samples: int, whole: bool) -> Errors:
    """Compare a run with a reference.

    Parameters
    ----------
    samples
        Number of samples up to the horizon, at which trajectories are compared.
    whole
        Whether the reference reaches the end of the scene, so its statistics are those of the whole run.
    """
    position, velocity = scale.apart(run.until(samples), reference.until(samples))
    horizon = float(reference.time[samples - 1]) if samples else 0.0
    impact, missed = _late(run, reference, horizon)
    count = min(len(run), len(reference))
    dispersion = spread(run.velocity[:count]) - spread(reference.velocity[:count])
    size = spread(run.position[:count]) - spread(reference.position[:count])
    return Errors(
        position=_total(position),
        velocity=_total(velocity),
        impact=impact,
        missed=missed,
        energy=run.energy_error,
        energy_gain=run.energy_gain,
        momentum=run.momentum_error,
        angular_momentum=run.angular_momentum_error,
        overlap=run.overlap,
        sinking=run.sinking,
        impacts=abs(run.impacts / reference.impacts - 1.0) if whole and reference.impacts else np.nan,
        size=_total(size / scale.length) if scale.box is None else np.nan,
        dispersion=_total(dispersion / scale.speed),
    )


def _late(run: Trajectory, reference: Trajectory, horizon: float) -> tuple[float, float]:
    """Return the rms error in s of the first contacts up to the horizon, and how many pairs never met."""
    met = {tuple(pair): time for pair, time in zip(run.pair.tolist(), run.met.tolist(), strict=True)}
    due = [
        (tuple(pair), time)
        for pair, time in zip(reference.pair.tolist(), reference.met.tolist(), strict=True)
        if time <= horizon
    ]
    if not due:
        return np.nan, np.nan
    late = np.array([min(met.get(pair, horizon), horizon) - time for pair, time in due])
    return _total(late), float(sum(met.get(pair, np.inf) > horizon for pair, _ in due))


def _rms(vectors: FloatArray) -> FloatArray:
    """Return the rms length of (K, n, 3) vectors over the bodies, (K,)."""
    return np.asarray(np.sqrt(np.mean(np.sum(vectors * vectors, axis=2), axis=1)))


def _total(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values * values))) if len(values) else np.nan
