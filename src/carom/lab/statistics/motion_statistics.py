"""Motion: free paths and impacts, and the velocity distribution with the stress tensor.

A body's path is the polyline through its positions in the frames and at its impacts. It continues across the faces of a
periodic box and follows curved paths in a field. At an impact, the centre is one radius from the contact point.
Histograms contain only complete paths, so they lack some long paths, which the ends of the interval cut off. The means
have no such error: they are the time and the length of all paths, divided by the number of impacts
(docs/statistics.md).

In a Maxwellian gas, the normal velocity at impacts has Rayleigh's distribution, v exp(-v²/2s²)/s²: the relative
velocity along the normal is Gaussian, and fast pairs meet more often (Chapman & Cowling).

Velocities c are relative to the centre of mass. The fourth cumulant is a₂ = 3⟨c⁴⟩/(5⟨c²⟩²) - 1, the coefficient of the
second Sonine polynomial (van Noije & Ernst, Granular Matter 1, 57, 1998): 0 for a Maxwellian, above 0 if fast bodies
are more frequent. c is weighted with √m, so that bodies of different masses at one temperature have one distribution.

A sample of N velocities has D = 3 (N - 1) degrees of freedom. The mean of ⟨c⁴⟩/⟨c²⟩² over samples of a Maxwellian is
5/3 D/(D + 2), so the ratio of a sample is multiplied by (D + 2)/D. The variance of a₂ is 8/(15 N).

The stress is σ = (1/V) [⟨Σ m c ⊗ c⟩ + (1/t) Σ ℓ ⊗ J + Σ ℓ ⊗ J over frames / Σ dt]: momentum that bodies carry, and
momentum that impacts of the interval and lasting contacts in the steps of some frames transfer. J is the impulse on j
along the normal, and ℓ points from the centre of i to that of j, or to a plane. Compression is positive. Irving &
Kirkwood, J. Chem. Phys. 18, 817 (1950); Love and Weber for contacts, as in Christoffersen, Mehrabadi & Nemat-Nasser, J.
Appl. Mech. 48, 339 (1981).
"""

from __future__ import annotations

from dataclasses import replace
from math import pi, sqrt
from typing import NamedTuple

import numpy as np

from carom.arrays import FloatArray, IntArray
from carom.errors import RecordingError
from carom.extend import ENERGY, LENGTH, RATE, TIME, VELOCITY, Dimension, minimum_images
from carom.lab.statistics import Histogram, Interval, MeasuredValue, NothingThereError, Statistic

_BEFORE, _IMPACT, _AFTER = range(3)  # kinds of vertices of a path, in order
PLANES = "planes"  # the group of planes and walls
WIDTH = 5.0  # standard deviations of a histogram of velocities, to each side
BINS = 50
PRESSURE = Dimension("pressure", "Pa", (-1, -2, 1, 0), "3 kPa")


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
    impacts, moving, left_out = interval.impacts, interval.moving, interval.impacts_left_out
    ends = np.concatenate([impacts.i, impacts.j])
    # an impact of two bodies is two collisions; the number is scaled to include impacts that were not recorded
    collisions = np.count_nonzero(moving[ends[ends < interval.bodies]]) * (1.0 + left_out / len(impacts.step))
    exposure = np.count_nonzero(moving) * interval.duration
    paths = paths_of(interval)
    spread = 1.0 / np.sqrt(len(impacts.step))  # relative error of a count of independent impacts

    def known(label: str, value: float, dimension: Dimension) -> MeasuredValue:
        return MeasuredValue(label, value, dimension, value * spread)

    values = {
        "impacts": MeasuredValue("impacts", len(impacts.step) + left_out),
        "collision_rate": known("collisions of a body", collisions / exposure, RATE),
        "mean_free_time": known("mean free time", exposure / collisions, TIME),
        "mean_free_path": known("mean free path", paths.length / collisions, LENGTH),
    }
    histograms = {
        "free_times": Histogram.of("free time", paths.free_times, TIME, falls=True),
        "free_paths": Histogram.of("free path", paths.free_paths, LENGTH, falls=True),
    }
    lack = f"of these impacts, {left_out} were not recorded; with --replay they are computed again" if left_out else ""
    return Statistic(values, histograms, note=lack)


def paths_of(interval: Interval) -> Paths:
    """Follow all bodies from frame to frame and from impact to impact."""
    impacts, n, moving = interval.impacts, interval.bodies, interval.moving
    radius = interval.recording.bodies.radius
    box = np.zeros(3) if interval.box is None else interval.box
    since = np.zeros(n)  # m, the path of each body since its last impact
    last = np.full(n, -np.inf)  # s, the time of that impact
    total, times, lengths = 0.0, [np.empty(0)], [np.empty(0)]
    bounds = np.searchsorted(impacts.step, interval.step, side="right")
    before = interval.positions.drawn(int(interval.step[0]))
    for frame in range(1, len(interval.step)):
        after = interval.positions.drawn(int(interval.step[frame]))
        rows = slice(bounds[frame - 1], bounds[frame])
        columns = (impacts.i, impacts.j, impacts.time, impacts.point, impacts.normal)
        i, j, time, point, normal = (column[rows] for column in columns)
        pair = j < n  # impacts of two bodies; the others are on planes
        centres = point - radius[i][:, None] * normal, point[pair] + radius[j[pair]][:, None] * normal[pair]
        body, time, centre = np.concatenate([i, j[pair]]), np.concatenate([time, time[pair]]), np.concatenate(centres)
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


def measure_impacts(interval: Interval) -> Statistic:
    """Count the impacts of each pair of groups, and measure their approach speeds."""
    impacts = interval.impacts
    speed, count = impacts.speed, len(impacts.speed)
    mean = float(speed.mean())
    counted = "recorded impacts" if interval.impacts_left_out else "impacts in all"
    values = {
        "impact_rate": MeasuredValue(counted, count / interval.duration, RATE, sqrt(count) / interval.duration),
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
    return Statistic(values, {"approach_speeds": histogram}, _rows_of_groups(interval), note=_missing_impacts(interval))


def _missing_impacts(interval: Interval) -> str:
    """Return how many impacts are missing from an interval that has some, and the remedy; empty if none are."""
    left_out = interval.impacts_left_out
    if not left_out:
        return ""
    return f"without {left_out} smaller impacts, which were not recorded; with --replay they are computed again"


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


def measure_velocities(interval: Interval) -> Statistic:
    """Measure the velocities of moving bodies, averaged over the moments with exact states."""
    moving, mass = interval.moving, interval.recording.bodies.mass
    if np.count_nonzero(moving) < 2:
        raise RecordingError("a distribution of velocities needs at least two bodies that can move")
    velocity, mass = interval.velocities[:, moving], mass[moving]
    there = ~np.isnan(velocity[:, :, 0])
    enough = there.sum(axis=1) >= 2
    if not enough.any():
        raise RecordingError("at no moment do two bodies exist that can move")
    velocity, there = velocity[enough], there[enough]
    weighted = peculiar(velocity, mass)
    if not np.nan_to_num(weighted).any():
        raise RecordingError("all bodies are at rest")
    temperature = np.nanmean(weighted * weighted, axis=(1, 2))  # J, of each state
    mean = float(temperature.mean())
    count = np.count_nonzero(there)
    states = list(zip(weighted, there, strict=True))
    values = {
        "states": MeasuredValue("exact states", len(velocity)),
        "mean_velocity": MeasuredValue("mean velocity", np.nanmean(velocity, axis=(0, 1)), VELOCITY),
        "temperature": MeasuredValue("granular temperature, m c²/3", mean, ENERGY, mean * sqrt(2 / (3 * count))),
        "temperature_of_axes": MeasuredValue("… of x, y, z", np.nanmean(weighted * weighted, axis=(0, 1)), ENERGY),
        "fourth_cumulant": MeasuredValue(
            "fourth cumulant a₂",
            float(np.mean([fourth_cumulant(w[t]) for w, t in states])),
            error=sqrt(8 / (15 * count)),
        ),
    }
    edges = np.linspace(-WIDTH, WIDTH, BINS + 1)
    scaled = (weighted / np.sqrt(temperature)[:, None, None])[there]
    density = np.histogram(scaled, edges)[0] / (scaled.size * np.diff(edges))
    middle = (edges[1:] + edges[:-1]) / 2
    maxwell = np.exp(-(middle**2) / 2) / sqrt(2 * pi)
    histogram = Histogram("velocity component / its rms", edges, density, expected=maxwell, theory="Maxwell")
    rows = [
        {
            "group": name,
            "bodies": MeasuredValue("bodies", int(np.count_nonzero(own))),
            "temperature": MeasuredValue("temperature", float(np.nanmean(weighted[:, own] ** 2)), ENERGY),
            "fourth_cumulant": MeasuredValue(
                "a₂",
                float(np.mean([fourth_cumulant(w[own & t]) for w, t in states if np.count_nonzero(own & t) > 1])),
            ),
        }
        for name, own in interval.groups(moving)
        if (there & own).sum(axis=1).max() > 1
    ]
    return Statistic(values, {"velocities": histogram}, rows if len(rows) > 1 else ())


def peculiar(velocity: FloatArray, mass: FloatArray) -> FloatArray:
    """Return √m c in √J for velocities (k, n, 3) m/s, with c relative to the centre of mass of each state.

    The velocity of a body that does not exist is NaN.
    """
    present = np.where(np.isnan(velocity[:, :, 0]), 0.0, mass)
    drift = np.einsum("kna,kn->ka", np.nan_to_num(velocity), present) / present.sum(axis=1)[:, None]
    return np.asarray(np.sqrt(mass)[:, None] * (velocity - drift[:, None]))


def fourth_cumulant(weighted: FloatArray) -> float:
    """Return a₂ of peculiar velocities (n, 3), at least two."""
    square = (weighted * weighted).sum(axis=1)
    freedom = 3 * (len(square) - 1)
    with np.errstate(invalid="ignore"):  # bodies at rest have none
        return float(0.6 * np.mean(square * square) / np.mean(square) ** 2 * (freedom + 2) / freedom - 1)


def measure_stress(interval: Interval) -> Statistic:
    """Measure the mean stress in the box; without a box, the stress times the unknown volume."""
    moving, recording = interval.moving, interval.recording
    weighted = peculiar(interval.velocities[:, moving], recording.bodies.mass[moving])
    weighted = np.nan_to_num(weighted)  # bodies that do not exist carry no momentum
    kinetic = np.einsum("kna,knb->ab", weighted, weighted) / len(weighted)
    impacts, spread, lasting, notes, lack = np.zeros((3, 3)), 0.0, np.zeros((3, 3)), list[str](), ""
    try:
        held = interval.contacts
        virial = arms(interval, held.i, held.j) * held.impulse
        lasting = np.einsum("k,ka,kb->ab", virial, held.normal, held.normal) / held.elapsed
    except NothingThereError:
        pass
    except RecordingError as error:
        notes.append(f"only the kinetic part: {error}")
    try:
        if not recording.engine:  # the forces of another engine's contacts include impacts
            met = interval.impacts
            virial = arms(interval, met.i, met.j) * met.impulse
            impacts = np.einsum("k,ka,kb->ab", virial, met.normal, met.normal) / interval.duration
            spread, lack = sqrt(float(np.sum(virial * virial))) / (3 * interval.duration), _missing_impacts(interval)
    except NothingThereError:
        pass
    except RecordingError as error:
        notes = notes or [f"without impacts: {error}"]
    complete = not notes
    if lack:
        notes.append(lack)
    if recording.info["has_friction"]:
        notes.append("without friction, of which recordings have only the magnitude; it does not change the pressure")
    volume, dimension = interval.volume, PRESSURE
    if volume is None:
        volume, dimension = 1.0, ENERGY
        notes.append("there is no box, so the stress is not divided by a volume")
    elif interval.is_partly_empty:
        notes.append(
            "divided by the volume of domain.size, also where planes and walls, or a free surface, end the bodies"
        )

    def pressure(label: str, part: FloatArray, error: float | None = None) -> MeasuredValue:
        return MeasuredValue(label, float(np.trace(part)) / 3 / volume, dimension, error and error / volume)

    values = {"kinetic_pressure": pressure("pressure of moving bodies, a third of the trace", kinetic)}
    if complete:
        total = kinetic + impacts + lasting
        values["impact_pressure"] = pressure("… of impacts", impacts, spread)
        values["contact_pressure"] = pressure("… of lasting contacts", lasting)
        values["pressure"] = pressure("… in all", total, spread)
        if kinetic.any() and not lasting.any():
            ratio = float(np.trace(total) / np.trace(kinetic))
            values["compressibility"] = MeasuredValue("… in all / of moving bodies", ratio)
        values["stress"] = MeasuredValue("stress", total / volume, dimension)
    return Statistic(values, note="; ".join(notes))


def arms(interval: Interval, i: IntArray, j: IntArray) -> FloatArray:
    """Return the distances between the centres of touching bodies, or of a body and a plane, (k,) m."""
    radius, pair = interval.recording.bodies.radius, j < interval.bodies
    return np.asarray(radius[i] + np.where(pair, radius[np.where(pair, j, 0)], 0.0))
