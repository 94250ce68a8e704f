"""Motion: free paths and impacts, and the velocity distribution with the stress tensor.

A body's path is the polyline through its positions in the frames and at its impacts. It continues across the faces of a
periodic box and follows curved paths in a field. At an impact, the centre is one radius from the contact point.
Histograms contain only complete paths: they lack some long paths that the ends of the interval cut off. The means
have no such error: they are the time and the length of all paths, divided by the number of impacts
(docs/statistics.md). Means and totals come from `ImpactSums`.

In a Maxwellian gas, the normal velocity at impacts has Rayleigh's distribution, v exp(-v²/2s²)/s²: the relative
velocity along the normal is Gaussian, and fast pairs meet more often (Chapman & Cowling).

Velocities c are relative to the centre of mass. The fourth cumulant is a₂ = 3⟨c⁴⟩/(5⟨c²⟩²) - 1, the coefficient of the
second Sonine polynomial (van Noije & Ernst, Granular Matter 1, 57, 1998): 0 for a Maxwellian, above 0 if fast bodies
are more frequent. The velocity c is weighted with √m, so that bodies of different masses at one temperature have the
same distribution.

A sample of N velocities has D = 3 (N - 1) degrees of freedom. The mean of ⟨c⁴⟩/⟨c²⟩² over samples of a Maxwellian is
5/3 D/(D + 2), so the ratio of a sample is multiplied by (D + 2)/D. The variance of a₂ is 8/(15 N).

The stress is σ = (1/V) [⟨Σ m c ⊗ c⟩ + (1/t) Σ ℓ ⊗ J + Σ ℓ ⊗ J over frames / Σ dt]: the momentum that bodies carry, the
momentum that impacts of the interval transfer, and the momentum that lasting contacts transfer in the steps of some
frames. J is the impulse on j, without friction for lasting contacts, and ℓ points from the centre of i to the centre of
j, or to a plane. Compression is positive. Irving & Kirkwood, J. Chem. Phys. 18, 817 (1950); Love and Weber for
contacts, as in Christoffersen, Mehrabadi & Nemat-Nasser, J. Appl. Mech. 48, 339 (1981).
"""

from __future__ import annotations

from dataclasses import replace
from math import pi, sqrt
from typing import NamedTuple

import numpy as np

from carom.arrays import FloatArray
from carom.errors import RecordingError
from carom.lab.statistics import Interval, NothingThereError
from carom.lab.statistics.statistic import Histogram, MeasuredValue, Statistic
from carom.physics.vector import minimum_images
from carom.scene.units.dimension import ENERGY, LENGTH, RATE, TIME, VELOCITY, Dimension

_BEFORE, _IMPACT, _AFTER = range(3)  # kinds of vertices of a path, in order
PLANES = "planes"  # name of the group of planes and walls
WIDTH = 5.0  # half-width of a histogram of velocities, in standard deviations
BINS = 50
PRESSURE = Dimension("pressure", "Pa", (-1, -2, 1, 0), "3 kPa")


class Paths(NamedTuple):
    """The paths of the moving bodies in an interval."""

    length: float  # m, total length of these paths
    free_times: FloatArray  # (k,) s, time from an impact of a body to its next impact
    free_paths: FloatArray  # (k,) m, length of the path in that time


def measure_free_paths(interval: Interval) -> Statistic:
    """Measure the free times and paths of moving bodies."""
    interval.refuse_shear("free paths")
    if interval.recording.lives is not None:
        raise RecordingError("free paths are not measured in recordings whose bodies come and go")
    sums, moving, left_out = interval.sums, interval.moving, interval.impacts_left_out
    exposure = np.count_nonzero(moving) * interval.duration
    paths = None if left_out else paths_of(interval)
    length = sums.path if paths is None or np.isfinite(sums.path) else paths.length
    spread = 1.0 / sqrt(sums.impacts)  # relative error of a number of independent impacts

    def known(label: str, value: float, dimension: Dimension) -> MeasuredValue:
        return MeasuredValue(label, value, dimension, value * spread)

    values = {
        "impacts": MeasuredValue("impacts", int(sums.impacts)),
        "collision_rate": known("collisions of a body", sums.collisions / exposure, RATE),
        "mean_free_time": known("mean free time", exposure / sums.collisions, TIME),
        "mean_free_path": known("mean free path", length / sums.collisions, LENGTH),
    }
    if paths is None:
        return Statistic(values, note=_without_histogram(interval))
    histograms = {
        "free_times": Histogram.of("free time", paths.free_times, TIME, falls=True),
        "free_paths": Histogram.of("free path", paths.free_paths, LENGTH, falls=True),
    }
    return Statistic(values, histograms)


def _without_histogram(interval: Interval) -> str:
    """Return why an interval has no histogram of its impacts, and the remedy."""
    return (
        f"no histogram, since {interval.impacts_left_out} smaller impacts have no rows of their own; type "
        f"`{interval.command_again}`"
    )


def paths_of(interval: Interval) -> Paths:
    """Follow all bodies from frame to frame and from impact to impact."""
    impacts, n, moving = interval.impacts, interval.bodies, interval.moving
    radius = interval.recording.bodies.radius
    box = np.zeros(3) if interval.box is None else interval.box
    since = np.zeros(n)  # m, the path of each body since its last impact
    last = np.full(n, -np.inf)  # s, the time of each body's last impact
    total, times, lengths = 0.0, [np.empty(0)], [np.empty(0)]
    bounds = np.searchsorted(impacts.step, interval.step, side="right")
    before = interval.positions.drawn(int(interval.step[0]))
    for frame in range(1, len(interval.step)):
        after = interval.positions.drawn(int(interval.step[frame]))
        rows = slice(bounds[frame - 1], bounds[frame])
        columns = (impacts.i, impacts.j, impacts.time, impacts.point, impacts.normal)
        i, j, time, point, normal = (column[rows] for column in columns)
        pair = j < n  # impacts between bodies; the others are on planes
        centres = point - radius[i][:, None] * normal, point[pair] + radius[j[pair]][:, None] * normal[pair]
        body, time, centre = np.concatenate([i, j[pair]]), np.concatenate([time, time[pair]]), np.concatenate(centres)
        involved = np.unique(body)
        direct = np.linalg.norm(minimum_images(after - before, box), axis=1)
        direct[involved] = 0.0
        since += direct
        total += float(direct[moving].sum())
        if len(involved):
            # vertices of the polylines: positions in the previous frame, at impacts, and in this frame
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
    sums, duration = interval.sums, interval.duration
    count = sums.impacts
    mean, square = sums.speed / count, sums.speed_square / count
    scatter = sqrt(max(0.0, square - mean * mean) / count) if count > 1 else None
    values = {
        "impact_rate": MeasuredValue("impacts in all", count / duration, RATE, sqrt(count) / duration),
        "mean_approach_speed": MeasuredValue("mean approach speed", mean, VELOCITY, scatter),
        "rms_approach_speed": MeasuredValue("root mean square", sqrt(square), VELOCITY),
        "largest_approach_speed": MeasuredValue("largest", sums.largest_speed, VELOCITY),
    }
    rows = _rows_of_groups(interval)
    if interval.impacts_left_out:
        return Statistic(values, rows=rows, note=_without_histogram(interval))
    histogram = Histogram.of("approach speed", interval.impacts.speed, VELOCITY)
    scale = square / 2  # s² of Rayleigh's distribution, m²/s²
    middle = (histogram.edges[1:] + histogram.edges[:-1]) / 2
    rayleigh = middle / scale * np.exp(-(middle**2) / (2 * scale)) if scale > 0.0 else None
    histogram = replace(histogram, expected=rayleigh, theory="Maxwell")
    return Statistic(values, {"approach_speeds": histogram}, rows)


def _rows_of_groups(interval: Interval) -> list[dict[str, MeasuredValue | str]]:
    """Return a row for each pair of groups that met, the most frequent first."""
    pairs, names = interval.sums.pairs, [*(name for name, _ in interval.groups()), PLANES]
    rows = list[dict[str, MeasuredValue | str]]()
    for k in np.argsort(-pairs.impacts, kind="stable").tolist():
        count, speed = float(pairs.impacts[k]), float(pairs.speed[k])
        row: dict[str, MeasuredValue | str] = {
            "groups": f"{names[pairs.first[k]]} and {names[pairs.second[k]]}",
            "impacts": MeasuredValue("impacts", int(count)),
            "rate": MeasuredValue("rate", count / interval.duration, RATE, sqrt(count) / interval.duration),
            "mean_approach_speed": MeasuredValue("mean approach speed", speed / count, VELOCITY),
        }
        lost = float(pairs.restitution_loss[k] + pairs.friction_loss[k])
        if np.isfinite(lost):
            row["energy_lost"] = MeasuredValue("energy lost", lost, ENERGY)
        rows.append(row)
    return rows


def measure_velocities(interval: Interval) -> Statistic:
    """Measure the velocities of moving bodies, averaged over the moments with exact states."""
    moving, mass = interval.moving, interval.recording.bodies.mass
    if np.count_nonzero(moving) < 2:
        raise RecordingError("a distribution of velocities needs at least two bodies that can move")
    velocity, mass = interval.velocities[:, moving], mass[moving]
    there = ~np.isnan(velocity[:, :, 0])
    enough = there.sum(axis=1) >= 2
    if not enough.any():
        raise RecordingError("two bodies that can move never exist at the same time")
    velocity, there = velocity[enough], there[enough]
    weighted = peculiar(velocity, mass)
    if not np.nan_to_num(weighted).any():
        raise RecordingError("all bodies are at rest")
    temperature = np.nanmean(weighted * weighted, axis=(1, 2))  # J, of each state
    of_axes, note = np.nanmean(weighted * weighted, axis=1).mean(axis=0), ""  # every state has the same weight
    kinetic = interval.kinetic
    if kinetic is not None and interval.recording.lives is None:  # otherwise the number of bodies changes
        of_axes = kinetic.diagonal() / len(mass)
        note = "temperatures without a group come from all frames, everything else from the exact states"
    mean = float(of_axes.mean())
    count = np.count_nonzero(there)
    states = list(zip(weighted, there, strict=True))
    values = {
        "states": MeasuredValue("exact states", len(velocity)),
        "mean_velocity": MeasuredValue("mean velocity", np.nanmean(velocity, axis=(0, 1)), VELOCITY),
        "temperature": MeasuredValue("granular temperature, m c²/3", mean, ENERGY, mean * sqrt(2 / (3 * count))),
        "temperature_of_axes": MeasuredValue("… of x, y, z", of_axes, ENERGY),
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
    return Statistic(values, {"velocities": histogram}, rows if len(rows) > 1 else (), note)


def peculiar(velocity: FloatArray, mass: FloatArray) -> FloatArray:
    """Return √m c in √J for velocities (k, n, 3) m/s, with c relative to the centre of mass of each state.

    The velocity of a body that does not exist is NaN.
    """
    present = np.where(np.isnan(velocity[:, :, 0]), 0.0, mass)
    drift = np.einsum("kna,kn->ka", np.nan_to_num(velocity), present) / present.sum(axis=1)[:, None]
    return np.asarray(np.sqrt(mass)[:, None] * (velocity - drift[:, None]))


def fourth_cumulant(weighted: FloatArray) -> float:
    """Return a₂ of at least two peculiar velocities, (n, 3)."""
    square = (weighted * weighted).sum(axis=1)
    freedom = 3 * (len(square) - 1)
    with np.errstate(invalid="ignore"):  # bodies at rest have no direction
        return float(0.6 * np.mean(square * square) / np.mean(square) ** 2 * (freedom + 2) / freedom - 1)


def measure_stress(interval: Interval) -> Statistic:
    """Measure the mean stress in the box; without a box, the product of the stress and the unknown volume."""
    moving, recording = interval.moving, interval.recording
    kinetic = interval.kinetic
    if kinetic is None:
        weighted = peculiar(interval.velocities[:, moving], recording.bodies.mass[moving])
        weighted = np.nan_to_num(weighted)  # bodies that do not exist carry no momentum
        kinetic = np.einsum("kna,knb->ab", weighted, weighted) / len(weighted)
    impacts, spread, lasting, notes = np.zeros((3, 3)), 0.0, np.zeros((3, 3)), list[str]()
    lacks_friction = False
    try:
        held = interval.contacts
        virial = interval.arms(held.i, held.j) * held.impulse
        lasting = np.einsum("k,ka,kb->ab", virial, held.normal, held.normal) / held.elapsed
        lacks_friction = True
    except NothingThereError:
        pass
    except RecordingError as error:
        notes.append(f"only the kinetic part: {error}")
    try:
        if not recording.engine:  # contact forces of another engine include impacts
            sums = interval.sums
            impacts = sums.virial / interval.duration
            spread = sqrt(sums.virial_square) / (3 * interval.duration)
            lacks_friction |= bool(np.isnan(sums.path))  # sums over rows have no path, and lack friction
    except NothingThereError:
        pass
    except RecordingError as error:
        notes = notes or [f"only the kinetic part: {error}"]
    complete = not notes
    if recording.info["has_friction"] and lacks_friction:
        notes.append("without friction, whose direction is not recorded; the pressure does not depend on it")
    volume, dimension = interval.volume, PRESSURE
    if volume is None:
        volume, dimension = 1.0, ENERGY
        notes.append("there is no box, so the stress is not divided by a volume")
    elif interval.is_partly_empty:
        notes.append("divided by the volume of domain.size, even if planes, walls or a free surface bound the bodies")

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
