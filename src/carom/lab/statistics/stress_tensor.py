"""The stress tensor: momentum that bodies carry, and momentum that impacts and contacts pass on.

σ = (1/V) [⟨Σ m c ⊗ c⟩ + (1/t) Σ ℓ ⊗ J + Σ ℓ ⊗ J over frames / Σ dt]: the kinetic part, impacts of the interval, and
lasting contacts in the steps of some frames. J is the impulse on j along the normal, and ℓ points from the centre of i
to that of j, or to a plane. Compression is positive. Irving & Kirkwood, J. Chem. Phys. 18, 817 (1950); Love and Weber
for contacts, as in Christoffersen, Mehrabadi & Nemat-Nasser, J. Appl. Mech. 48, 339 (1981).
"""

from __future__ import annotations

from math import sqrt

import numpy as np

from carom.arrays import FloatArray, IntArray
from carom.errors import RecordingError
from carom.extend import ENERGY, Dimension
from carom.lab.statistics.interval import Interval
from carom.lab.statistics.statistic import MeasuredValue, Statistic
from carom.lab.statistics.velocity_distribution import peculiar

PRESSURE = Dimension("pressure", "Pa", (-1, -2, 1, 0), "3 kPa")


def measure(interval: Interval) -> Statistic:
    """Measure the mean stress over the volume of the box, or times the volume without a box."""
    moving = interval.moving
    weighted = peculiar(interval.velocities[:, moving], interval.recording.bodies.mass[moving])
    kinetic = np.einsum("kna,knb->ab", weighted, weighted) / len(weighted)
    impacts, spread, lasting = np.zeros((3, 3)), 0.0, np.zeros((3, 3))
    notes = []
    try:
        met = interval.impacts
        arm = arms(interval, met.i, met.j)
        impacts = np.einsum("k,ka,kb->ab", arm * met.impulse, met.normal, met.normal) / interval.duration
        spread = sqrt(float(np.sum((arm * met.impulse) ** 2))) / (3 * interval.duration)
    except RecordingError as error:
        notes.append(f"without impacts: {error}")
    try:
        held = interval.contacts
        virial = arms(interval, held.i, held.j) * held.impulse
        lasting = np.einsum("k,ka,kb->ab", virial, held.normal, held.normal) / held.elapsed
    except RecordingError as error:
        notes.append(f"without lasting contacts: {error}")
    volume, dimension = interval.volume, PRESSURE
    if volume is None:
        volume, dimension = 1.0, ENERGY
    total = (kinetic + impacts + lasting) / volume
    ratio = float(np.trace(total) * volume / np.trace(kinetic)) if kinetic.any() else np.inf
    values: dict[str, MeasuredValue] = {
        "pressure": MeasuredValue(
            "pressure, a third of the trace", float(np.trace(total)) / 3, dimension, spread / volume
        ),
        "kinetic_pressure": MeasuredValue("… of moving bodies", float(np.trace(kinetic)) / 3 / volume, dimension),
        "impact_pressure": MeasuredValue(
            "… of impacts", float(np.trace(impacts)) / 3 / volume, dimension, spread / volume
        ),
        "contact_pressure": MeasuredValue("… of lasting contacts", float(np.trace(lasting)) / 3 / volume, dimension),
        **({} if lasting.any() else {"compressibility": MeasuredValue("pressure / kinetic pressure", ratio)}),
        "stress": MeasuredValue("stress", total, dimension),
    }
    if interval.recording.info["has_friction"]:
        notes.append("without friction, of which recordings have only the magnitude; it does not change the pressure")
    if interval.volume is None:
        notes.append("there is no box, so the stress is not divided by a volume")
    return Statistic(values, note="; ".join(notes))


def arms(interval: Interval, i: IntArray, j: IntArray) -> FloatArray:
    """Return the distances between the centres of touching bodies, or of a body and a plane, (k,) m."""
    radius, pair = interval.recording.bodies.radius, j < interval.bodies
    return np.asarray(radius[i] + np.where(pair, radius[np.where(pair, j, 0)], 0.0))
