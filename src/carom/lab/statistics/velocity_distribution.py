"""The velocity distribution: granular temperature, and the deviation from a Maxwellian.

Velocities c are relative to the centre of mass. The fourth cumulant is a₂ = 3⟨c⁴⟩/(5⟨c²⟩²) - 1, the coefficient of the
second Sonine polynomial (van Noije & Ernst, Granular Matter 1, 57, 1998): 0 for a Maxwellian, above 0 if fast bodies
are more frequent. c is weighted with √m, so that bodies of different masses at one temperature have one distribution.

A sample of N velocities has D = 3 (N - 1) degrees of freedom. The mean of ⟨c⁴⟩/⟨c²⟩² over samples of a Maxwellian is
5/3 D/(D + 2), so the ratio of a sample is multiplied by (D + 2)/D. The variance of a₂ is 8/(15 N).
"""

from __future__ import annotations

from math import pi, sqrt

import numpy as np

from carom.arrays import FloatArray
from carom.errors import RecordingError
from carom.extend import ENERGY, VELOCITY
from carom.lab.statistics.interval import Interval
from carom.lab.statistics.statistic import Histogram, MeasuredValue, Statistic

WIDTH = 5.0  # standard deviations of a histogram of velocities, to each side
BINS = 50


def measure(interval: Interval) -> Statistic:
    """Measure the velocities of moving bodies, averaged over the moments with exact states."""
    moving, mass = interval.moving, interval.recording.bodies.mass
    if np.count_nonzero(moving) < 2:
        raise RecordingError("a distribution of velocities needs at least two bodies that can move")
    velocity, mass = interval.velocities[:, moving], mass[moving]
    weighted = peculiar(velocity, mass)
    if not weighted.any():
        raise RecordingError("all bodies are at rest")
    temperature = (weighted * weighted).mean(axis=(1, 2))  # J, of each state
    mean = float(temperature.mean())
    count = weighted.shape[0] * weighted.shape[1]
    values = {
        "states": MeasuredValue("exact states", len(velocity)),
        "mean_velocity": MeasuredValue("mean velocity", velocity.mean(axis=(0, 1)), VELOCITY),
        "temperature": MeasuredValue("granular temperature, m c²/3", mean, ENERGY, mean * sqrt(2 / (3 * count))),
        "temperature_of_axes": MeasuredValue("… of x, y, z", (weighted * weighted).mean(axis=(0, 1)), ENERGY),
        "fourth_cumulant": MeasuredValue(
            "fourth cumulant a₂",
            float(np.mean([fourth_cumulant(state) for state in weighted])),
            error=sqrt(8 / (15 * count)),
        ),
    }
    edges = np.linspace(-WIDTH, WIDTH, BINS + 1)
    scaled = weighted / np.sqrt(temperature)[:, None, None]
    density = np.histogram(scaled, edges)[0] / (scaled.size * np.diff(edges))
    middle = (edges[1:] + edges[:-1]) / 2
    maxwell = np.exp(-(middle**2) / 2) / sqrt(2 * pi)
    histogram = Histogram("velocity component / its rms", edges, density, expected=maxwell, theory="Maxwell")
    rows = [
        {
            "group": name,
            "bodies": MeasuredValue("bodies", int(np.count_nonzero(own))),
            "temperature": MeasuredValue("temperature", float((weighted[:, own] ** 2).mean()), ENERGY),
            "fourth_cumulant": MeasuredValue("a₂", float(np.mean([fourth_cumulant(state[own]) for state in weighted]))),
        }
        for name, own in interval.groups(moving)
        if np.count_nonzero(own) > 1
    ]
    return Statistic(values, {"velocities": histogram}, rows if len(rows) > 1 else ())


def peculiar(velocity: FloatArray, mass: FloatArray) -> FloatArray:
    """Return √m c in √J for velocities (k, n, 3) m/s, with c relative to the centre of mass of each state."""
    drift = np.einsum("kna,n->ka", velocity, mass) / mass.sum()
    return np.asarray(np.sqrt(mass)[:, None] * (velocity - drift[:, None]))


def fourth_cumulant(weighted: FloatArray) -> float:
    """Return a₂ of peculiar velocities (n, 3), at least two."""
    square = (weighted * weighted).sum(axis=1)
    freedom = 3 * (len(square) - 1)
    with np.errstate(invalid="ignore"):  # bodies at rest have none
        return float(0.6 * np.mean(square * square) / np.mean(square) ** 2 * (freedom + 2) / freedom - 1)
