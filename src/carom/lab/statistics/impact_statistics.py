"""Impacts: free times and free paths of bodies between them, rates by pair of groups, and approach speeds.

A body's path is the polyline through its positions in the frames and at its impacts. It continues across the faces of a
periodic box and follows curved paths in a field. At an impact, the centre is one radius from the contact point.
Histograms contain only complete paths, so they lack some long paths, which the ends of the interval cut off. The means
have no such error: they are the time and the length of all paths, divided by the number of impacts
(docs/statistics.md).

In a Maxwellian gas, the normal velocity at impacts has Rayleigh's distribution, v exp(-v²/2s²)/s²: the relative
velocity along the normal is Gaussian, and fast pairs meet more often (Chapman & Cowling).
"""

from __future__ import annotations

from dataclasses import replace
from math import sqrt
from typing import NamedTuple

import numpy as np

from carom.arrays import FloatArray, IntArray
from carom.errors import RecordingError
from carom.extend import LENGTH, RATE, TIME, VELOCITY, Dimension, minimum_images
from carom.lab.statistics.interval import Interval
from carom.lab.statistics.statistic import Histogram, MeasuredValue, Statistic

_BEFORE, _IMPACT, _AFTER = range(3)  # kinds of vertices of a path, in order
PLANES = "planes"  # the group of planes and walls


class Paths(NamedTuple):
    """The paths of the moving bodies in an interval."""

    length: float  # m, of all of them
    free_times: FloatArray  # (k,) s, from an impact of a body to its next one
    free_paths: FloatArray  # (k,) m, the length of the path in that time


def measure_free_paths(interval: Interval) -> Statistic:
    """Measure the free times and paths of moving bodies."""
    interval.refuse_shear("free paths")
    if interval.recording.lives is not None:
        raise RecordingError("free paths are not measured in recordings whose bodies come and go")
    impacts, moving = interval.impacts, interval.moving
    ends = np.concatenate([impacts.i, impacts.j])
    all_of_them = 1.0 + interval.impacts_left_out / len(impacts.step)
    collisions = (
        np.count_nonzero(moving[ends[ends < interval.bodies]]) * all_of_them
    )  # an impact of two bodies is two collisions
    exposure = np.count_nonzero(moving) * interval.duration
    paths = paths_of(interval)
    spread = 1.0 / np.sqrt(len(impacts.step))  # relative error of a count of independent impacts

    def known(label: str, value: float, dimension: Dimension) -> MeasuredValue:
        return MeasuredValue(label, value, dimension, value * spread)

    values = {
        "impacts": MeasuredValue("impacts", len(impacts.step) + interval.impacts_left_out),
        "collision_rate": known("collisions of a body", collisions / exposure, RATE),
        "mean_free_time": known("mean free time", exposure / collisions, TIME),
        "mean_free_path": known("mean free path", paths.length / collisions, LENGTH),
    }
    histograms = {
        "free_times": Histogram.of("free time", paths.free_times, TIME, falls=True),
        "free_paths": Histogram.of("free path", paths.free_paths, LENGTH, falls=True),
    }
    left_out = interval.impacts_left_out
    lack = f"of these impacts, {left_out} were not recorded; with --replay they are computed again" if left_out else ""
    return Statistic(values, histograms, note=lack)


def paths_of(interval: Interval) -> Paths:
    """Follow all bodies from frame to frame and from impact to impact."""
    impacts, n = interval.impacts, interval.bodies
    box = np.zeros(3) if interval.box is None else interval.box
    moving = interval.moving
    since = np.zeros(n)  # m, the path of each body since its last impact
    last = np.full(n, -np.inf)  # s, the time of that impact
    total, times, lengths = 0.0, [np.empty(0)], [np.empty(0)]
    bounds = np.searchsorted(impacts.step, interval.step, side="right")
    before = interval.positions.drawn(int(interval.step[0]))
    for frame in range(1, len(interval.step)):
        after = interval.positions.drawn(int(interval.step[frame]))
        rows = slice(bounds[frame - 1], bounds[frame])
        body, time, centre = _ends(interval, rows)
        involved = np.unique(body)
        direct = np.linalg.norm(minimum_images(after - before, box), axis=1)
        direct[involved] = 0.0
        since += direct
        total += float(direct[moving].sum())
        if len(involved):
            # vertices of the polylines: the position in the previous frame, at impacts, and in this frame
            whose = np.concatenate([involved, body, involved])
            kind = np.repeat([_BEFORE, _IMPACT, _AFTER], [len(involved), len(body), len(involved)])
            when = np.concatenate([last[involved], time, np.zeros(len(involved))])
            place = np.concatenate([before[involved], centre, after[involved]])
            order = np.lexsort((when, kind, whose))
            whose, kind, when, place = whose[order], kind[order], when[order], place[order]
            begin = np.flatnonzero(kind[1:] != _BEFORE)  # first vertex of each segment
            end, whose = begin + 1, whose[begin]
            length = np.linalg.norm(minimum_images(place[end] - place[begin], box), axis=1)
            total += float(length[moving[whose]].sum())
            free = length + np.where(kind[begin] == _BEFORE, since[whose], 0.0)
            strikes = kind[end] == _IMPACT
            complete = strikes & np.isfinite(when[begin]) & moving[whose]
            times.append(when[end][complete] - when[begin][complete])
            lengths.append(free[complete])
            since[whose[~strikes]] = free[~strikes]
            np.maximum.at(last, body, time)
        before = after
    return Paths(total, np.concatenate(times), np.concatenate(lengths))


def _ends(interval: Interval, rows: slice) -> tuple[IntArray, FloatArray, FloatArray]:
    """Return both bodies of some impacts, (k,), the times (s), and their centres, (k, 3) m."""
    impacts, radius = interval.impacts, interval.recording.bodies.radius
    i, j, time, point, normal = (
        column[rows] for column in (impacts.i, impacts.j, impacts.time, impacts.point, impacts.normal)
    )
    pair = j < interval.bodies  # impacts of two bodies; the others are on planes
    centres = point - radius[i][:, None] * normal, point[pair] + radius[j[pair]][:, None] * normal[pair]
    return np.concatenate([i, j[pair]]), np.concatenate([time, time[pair]]), np.concatenate(centres)


def measure_impacts(interval: Interval) -> Statistic:
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
    return Statistic(values, {"approach_speeds": histogram}, _rows_of_groups(interval))


def _rows_of_groups(interval: Interval) -> list[dict[str, MeasuredValue | str]]:
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
