"""The stress tensor: momentum that bodies carry, and momentum that impacts and contacts transfer.

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
from carom.lab.statistics.interval import Interval, NothingThereError
from carom.lab.statistics.statistic import MeasuredValue, Statistic
from carom.lab.statistics.velocity_distribution import peculiar

PRESSURE = Dimension("pressure", "Pa", (-1, -2, 1, 0), "3 kPa")


def measure(interval: Interval) -> Statistic:
    """Measure the mean stress in the box; without a box, the stress times the unknown volume."""
    moving, recording = interval.moving, interval.recording
    weighted = peculiar(interval.velocities[:, moving], recording.bodies.mass[moving])
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
