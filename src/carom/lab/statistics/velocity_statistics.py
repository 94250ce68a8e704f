"""The velocity distribution with its granular temperature, and the stress tensor.

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

from math import pi, sqrt

import numpy as np

from carom.arrays import FloatArray, IntArray
from carom.errors import RecordingError
from carom.extend import ENERGY, VELOCITY, Dimension
from carom.lab.statistics.interval import Interval, NothingThereError
from carom.lab.statistics.statistic import Histogram, MeasuredValue, Statistic

WIDTH = 5.0  # standard deviations of a histogram of velocities, to each side
BINS = 50
PRESSURE = Dimension("pressure", "Pa", (-1, -2, 1, 0), "3 kPa")


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
    impacts, spread, lasting, notes = np.zeros((3, 3)), 0.0, np.zeros((3, 3)), list[str]()
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
            spread = sqrt(float(np.sum(virial * virial))) / (3 * interval.duration)
    except NothingThereError:
        pass
    except RecordingError as error:
        notes = notes or [f"without impacts: {error}"]
    complete = not notes
    if recording.info["has_friction"]:
        notes.append("without friction, of which recordings have only the magnitude; it does not change the pressure")
    volume, dimension = interval.volume, PRESSURE
    if volume is None:
        volume, dimension = 1.0, ENERGY
        notes.append("there is no box, so the stress is not divided by a volume")

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
