"""Impacts by pair of groups, and the speeds at which bodies meet.

In a Maxwellian gas, the normal velocity at impacts has Rayleigh's distribution, v exp(-v²/2s²)/s²: the relative
velocity along the normal is Gaussian, and fast pairs meet more often (Chapman & Cowling).
"""

from __future__ import annotations

from dataclasses import replace
from math import sqrt

import numpy as np

from carom.extend import RATE, VELOCITY
from carom.lab.statistics.interval import Interval
from carom.lab.statistics.statistic import Histogram, MeasuredValue, Statistic

PLANES = "planes"  # the group of planes and walls


def measure(interval: Interval) -> Statistic:
    """Count the impacts of each pair of groups, and measure their approach speeds."""
    impacts = interval.impacts
    speed, count = impacts.speed, len(impacts.speed)
    mean = float(speed.mean())
    values = {
        "impact_rate": MeasuredValue(
            "impacts in all", count / interval.duration, RATE, sqrt(count) / interval.duration
        ),
        "mean_approach_speed": MeasuredValue(
            "mean approach speed", mean, VELOCITY, float(speed.std()) / sqrt(count) if count > 1 else None
        ),
        "rms_approach_speed": MeasuredValue("root mean square", sqrt(float(np.mean(speed * speed))), VELOCITY),
        "largest_approach_speed": MeasuredValue("largest", float(speed.max()), VELOCITY),
    }
    histogram = Histogram.of("approach speed", speed, VELOCITY)
    scale = float(np.mean(speed * speed)) / 2  # s², m²/s²
    middle = (histogram.edges[1:] + histogram.edges[:-1]) / 2
    rayleigh = middle / scale * np.exp(-(middle**2) / (2 * scale)) if scale > 0.0 else None
    histogram = replace(histogram, expected=rayleigh, theory="Maxwell")
    return Statistic(values, {"approach_speeds": histogram}, _rows(interval))


def _rows(interval: Interval) -> list[dict[str, MeasuredValue | str]]:
    """Return a row for each pair of groups that met, the most frequent first."""
    impacts, groups = interval.impacts, interval.groups()
    group = np.full(interval.bodies, len(groups))
    for number, (_, own) in enumerate(groups):
        group[own] = number
    names = [*(name for name, _ in groups), PLANES]
    first = group[impacts.i]
    second = np.where(impacts.j < interval.bodies, group[np.minimum(impacts.j, interval.bodies - 1)], len(groups))
    key = np.minimum(first, second) * len(names) + np.maximum(first, second)
    pairs, inverse, counts = np.unique(key, return_inverse=True, return_counts=True)
    mean = np.bincount(inverse, impacts.speed) / counts
    return [
        {
            "groups": f"{names[pairs[k] // len(names)]} and {names[pairs[k] % len(names)]}",
            "impacts": MeasuredValue("impacts", int(counts[k])),
            "rate": MeasuredValue("rate", counts[k] / interval.duration, RATE, sqrt(counts[k]) / interval.duration),
            "mean_approach_speed": MeasuredValue("mean approach speed", float(mean[k]), VELOCITY),
        }
        for k in np.argsort(-counts, kind="stable").tolist()
    ]
