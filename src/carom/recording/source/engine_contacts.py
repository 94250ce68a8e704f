"""Contacts with forces as other engines report them, and their conversion to rows of the contact table."""

from __future__ import annotations

from typing import Any

import numpy as np

from carom.arrays import FloatArray, Records
from carom.contact_table import CONTACT_ROW, NO_ROWS, OPEN, RESTING
from carom.errors import RecordingError
from carom.physics.contact.graph import CollisionGraph

CONTACT = np.dtype(
    [
        ("i", np.int64),  # a body, or n + k for plane k
        ("j", np.int64),
        ("point", np.float64, 3),  # m
        ("normal", np.float64, 3),  # of length 1, from i to j
        ("force", np.float64),  # N, along the normal on j; the opposite acts on i
        ("friction", np.float64, 3),  # N, the tangential force on j
    ]
)
_ROUGHLY = 0.01  # largest relative error of the length of a normal


def has_forces(contacts: Any) -> bool:
    """Return whether contacts are records with forces, and not only pairs."""
    return getattr(getattr(contacts, "dtype", None), "names", None) is not None


def checked_contacts(engine: str, contacts: Any, bodies: int, ends: int) -> Records:
    """Return contacts as (m,) `CONTACT`.

    Raises
    ------
    RecordingError
        With the field and the row of the first invalid value.
    """
    names = CONTACT.names or ()
    if missing := [name for name in names if name not in contacts.dtype.names]:
        raise RecordingError(f"{engine}: contacts lack the field {missing[0]}; make them as carom.record.CONTACT")
    found = np.zeros(len(np.atleast_1d(contacts)), CONTACT)
    for name in names:
        found[name] = np.atleast_1d(contacts)[name]
    for name in ("point", "normal", "force", "friction"):
        wrong = ~np.isfinite(found[name])
        if wrong.any():
            raise RecordingError(f"{engine}: contacts[{int(np.argwhere(wrong)[0][0])}] has a {name} that is not finite")
    first, last = np.minimum(found["i"], found["j"]), np.maximum(found["i"], found["j"])
    wrong = (first < 0) | (last >= ends) | (first >= bodies) | (first == last)
    if wrong.any():
        row = found[np.argmax(wrong)]
        raise RecordingError(
            f"{engine}: contacts names {row['i']} and {row['j']}; bodies are 0 to {bodies - 1}, planes up to {ends - 1}"
        )
    length = np.linalg.norm(found["normal"], axis=1)
    wrong = np.abs(length - 1.0) > _ROUGHLY
    if wrong.any():
        row = int(np.argmax(wrong))
        raise RecordingError(f"{engine}: the normal of contacts[{row}] has the length {length[row]:g}; it must be 1")
    return found


def rows_of_contacts(contacts: Records, step: int, time: float, dt: float) -> Records:
    """Return a row of the contact table for each pair, (k,) `CONTACT_ROW`, sorted by pair.

    Several contacts of a pair become one: their total force at the centre of their normal forces. The impulse is the
    force times the time (s) since the previous frame.
    """
    if len(contacts) == 0:
        return NO_ROWS
    turned = contacts["i"] > contacts["j"]
    sign = np.where(turned, -1.0, 1.0)[:, None]
    pairs = np.sort(np.stack([contacts["i"], contacts["j"]], axis=1), axis=1)
    normal = sign * contacts["normal"]
    pushed = contacts["force"][:, None] * normal
    unique, place = np.unique(pairs, axis=0, return_inverse=True)
    place = place.ravel()

    def total(values: FloatArray) -> FloatArray:
        return np.stack([np.bincount(place, column, len(unique)) for column in values.T], axis=1)

    weight = np.abs(contacts["force"])
    weight = np.where(np.bincount(place, weight, len(unique))[place] > 0.0, weight, 1.0)
    point = total(weight[:, None] * contacts["point"]) / np.bincount(place, weight, len(unique))[:, None]
    push, force = total(pushed), total(pushed + sign * contacts["friction"])
    size = np.linalg.norm(push, axis=1)[:, None]
    direction = total(normal)
    direction /= np.maximum(np.linalg.norm(direction, axis=1), np.finfo(np.float64).tiny)[:, None]
    one = np.where(size > 0.0, push / np.where(size > 0.0, size, 1.0), direction)
    one *= np.where(np.einsum("ij,ij->i", one, direction) < 0.0, -1.0, 1.0)[:, None]  # where contacts attract
    along = np.einsum("ij,ij->i", force, one)
    rows = np.zeros(len(unique), CONTACT_ROW)
    rows["step"], rows["time"] = step, time
    rows["i"], rows["j"] = unique.T
    rows["normal_impulse"] = dt * along
    rows["mode"] = np.where(force.any(axis=1), RESTING, OPEN)
    for prefix, values in (("", point), ("n", one), ("friction_", dt * (force - along[:, None] * one))):
        for axis, component in zip("xyz", values.T, strict=True):
            rows[f"{prefix}{axis}"] = component
    return rows


def rows_of_graph(graph: CollisionGraph, position: FloatArray, radius: FloatArray, step: int, time: float) -> Records:
    """Return rows without impulses for the edges of a graph, where an engine's contacts are invalid."""
    rows = np.zeros(len(graph), CONTACT_ROW)
    rows["step"], rows["time"], rows["mode"] = step, time, OPEN
    rows["i"], rows["j"] = graph.pairs.T
    point = position[rows["i"]] + radius[rows["i"]][:, None] * graph.normals
    for prefix, values in (("", point), ("n", graph.normals)):
        for axis, component in zip("xyz", values.T, strict=True):
            rows[f"{prefix}{axis}"] = component
    return rows
