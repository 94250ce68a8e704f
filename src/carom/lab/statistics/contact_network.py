"""The network of lasting contacts: coordination number, rattlers and fabric.

Coordination number: Z = (2 contacts of two bodies + contacts with planes)/N. Rattlers are bodies held by too few
contacts. They are removed with their contacts, repeatedly, until none is left. The remaining bodies of a jammed packing
without friction have Z = 6, and 3 contacts per body if contacts with walls are counted once, too (O'Hern et al., Phys.
Rev. E 68, 011306, 2003). Fabric: F = ⟨n ⊗ n⟩ over contacts, with trace 1 (Satake 1982).
"""

from __future__ import annotations

import numpy as np

from carom.arrays import BoolArray, IntArray
from carom.lab.statistics.interval import Interval
from carom.lab.statistics.statistic import Histogram, MeasuredValue, Statistic

HOLDING = {False: 4, True: 2}  # smallest number of contacts that hold a sphere, without and with friction


def measure(interval: Interval) -> Statistic:
    """Measure the network, averaged over frames."""
    contacts, moving, n = interval.contacts, interval.moving, interval.bodies
    fewest = HOLDING[bool(interval.recording.info["has_friction"])]
    counts, held_counts, rattlers, kept_contacts = [], [], 0, 0
    for frame in range(contacts.frames):
        own = contacts.frame == frame
        pairs = np.stack([contacts.i[own], contacts.j[own]], axis=1)
        counts.append(contact_counts(pairs, n)[moving])
        held, kept = held_bodies(pairs, moving, fewest)
        held_counts.append(contact_counts(kept, n)[held])
        kept_contacts += len(kept)
        rattlers += int(np.count_nonzero(moving)) - int(np.count_nonzero(held))
    each, of_held = np.concatenate(counts), np.concatenate(held_counts)
    fabric = contacts.normal.T @ contacts.normal / len(contacts.normal)
    principal, axes = np.linalg.eigh(fabric)
    bodies = np.count_nonzero(moving) * contacts.frames
    values = {
        "frames": MeasuredValue("frames with their contacts", contacts.frames),
        "contacts": MeasuredValue("contacts that carry an impulse, of a frame", len(contacts.i) / contacts.frames),
        "coordination": MeasuredValue("contacts of a body", float(each.mean())),
        "rattlers": MeasuredValue(f"rattlers, held by fewer than {fewest} contacts", rattlers / bodies),
        "coordination_of_held": MeasuredValue(
            "contacts of a body without rattlers", float(of_held.mean()) if len(of_held) else np.nan
        ),
        "contacts_over_held": MeasuredValue(
            "contacts / bodies without rattlers", kept_contacts / len(of_held) if len(of_held) else np.nan
        ),
        "fabric": MeasuredValue("fabric", fabric),
        "anisotropy": MeasuredValue("… largest less smallest principal value", float(principal[-1] - principal[0])),
        "principal_direction": MeasuredValue("… direction of the largest", axes[:, -1]),
    }
    edges = np.arange(int(each.max()) + 2, dtype=np.float64) - 0.5
    share = np.histogram(each, edges)[0] / len(each)
    return Statistic(
        values, {"contacts_of_a_body": Histogram("contacts of a body", edges, share, function="fraction of the bodies")}
    )


def contact_counts(pairs: IntArray, bodies: int) -> IntArray:
    """Return the number of contacts of each body, (n,), given both ends of all contacts, (k, 2)."""
    ends = pairs.ravel()
    return np.bincount(ends[ends < bodies], minlength=bodies)


def held_bodies(pairs: IntArray, moving: BoolArray, fewest: int) -> tuple[BoolArray, IntArray]:
    """Remove rattlers and their contacts until none is left; return a mask of the other bodies, and their pairs.

    Planes and fixed bodies hold others, and need no contacts themselves.
    """
    n, held = len(moving), np.ones(max(len(moving), int(pairs.max(initial=0)) + 1), dtype=bool)
    while True:
        kept = pairs[held[pairs].all(axis=1)]
        loose = held[:n] & moving & (contact_counts(kept, n) < fewest)
        if not loose.any():
            return held[:n] & moving, kept
        held[:n] &= ~loose
