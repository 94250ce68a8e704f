"""The first bits that differ between two recordings: the bodies, their contact, and the laws that were broken."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from carom import Recording
from carom.errors import RecordingError

ARRAYS = ("position", "velocity", "orientation", "angular_velocity")


@dataclass(frozen=True, slots=True)
class FirstContact:
    """A contact of the first bodies that differ."""

    ends: tuple[int, int]  # from n on planes
    forces: tuple[float | None, float | None]  # N, along the normal; None where the run lacks this contact


@dataclass(frozen=True, slots=True)
class FirstBits:
    """The first frame whose exact states differ."""

    step: int
    time: float  # s
    bodies: list[int]  # whose states differ
    arrays: list[str]  # names of the arrays that differ
    contact: FirstContact | None  # the contact of these bodies whose force differs most; None if none is known
    laws: list[str]  # sentences about broken laws in the log of either run, in this step


def first_bits(a: Recording, b: Recording, step: int) -> FirstBits | None:
    """Compare the exact states of a step; None if they are not in both recordings, or equal."""
    if step not in a.checkpoint_times or step not in b.checkpoint_times:
        return None
    one, other = a.checkpoint(step), b.checkpoint(step)
    n = min(len(one.position), len(other.position))  # bodies may come in one run only
    differs, arrays = np.zeros(n, dtype=bool), list[str]()
    for name in ARRAYS:
        left, right = getattr(one, name), getattr(other, name)
        if left is None or right is None:
            continue
        changed = (left[:n].view(np.uint64) != right[:n].view(np.uint64)).any(axis=1)
        differs |= changed
        arrays += [name.replace("_", " ")] if changed.any() else []
    if not arrays:
        return None
    bodies = np.flatnonzero(differs)
    said = [event.text for run in (a, b) for event in run.warnings() if event.step == step]
    contact = _contact(a, b, one.time, bodies.tolist())
    return FirstBits(step, one.time, bodies.tolist(), arrays, contact, list(dict.fromkeys(said)))


def _contact(a: Recording, b: Recording, time: float, bodies: list[int]) -> FirstContact | None:
    """Return the contact of one of the bodies whose force differs most."""
    if not (a.records_contacts and b.records_contacts):
        return None
    forces: list[dict[tuple[int, int], float]] = []
    for run in (a, b):
        try:
            rows = run.contacts(time).to_pylist()
        except RecordingError:  # carom's own run of another version
            return None
        forces.append({(row["i"], row["j"]): row["normal_force"] or 0.0 for row in rows})
    own = [ends for ends in forces[0].keys() | forces[1].keys() if not set(ends).isdisjoint(bodies)]
    if not own:
        return None
    most = max(own, key=lambda ends: (abs(forces[0].get(ends, 0.0) - forces[1].get(ends, 0.0)), ends))
    return FirstContact(most, (forces[0].get(most), forces[1].get(most)))
