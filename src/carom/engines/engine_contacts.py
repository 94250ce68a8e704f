"""Contacts of other engines: reported with forces, or found by the distances between bodies."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from carom.arrays import BoolArray, FloatArray, IntArray, Records
from carom.contact_table import CONTACT_ROW, NO_ROWS, OPEN, RESTING
from carom.engines.source import CONTACT, ROUGHLY, Setup
from carom.errors import RecordingError
from carom.physics.contact.broad_phase.grid import HierarchicalGrid
from carom.physics.vector import minimum_images
from carom.state.frame import CollisionGraph, empty_graph


def whole_numbers(engine: str, name: str, values: Any) -> IntArray:
    """Return values as whole numbers. Raises RecordingError if a value has a fraction that a cast would drop."""
    given = np.asarray(values)
    with np.errstate(invalid="ignore"):
        found = given.astype(np.int64) if given.dtype.kind in "iuf" else np.empty(0, np.int64)
    if given.size and not np.array_equal(found, given):
        raise RecordingError(f"{engine}: {name} must be whole numbers, the numbers of bodies and planes")
    return found


def checked_contacts(engine: str, contacts: Any, bodies: int, ends: int) -> Records:
    """Return contacts as (m,) `CONTACT`. RecordingError names the field and the row of the first invalid value."""
    names = CONTACT.names or ()
    if missing := [name for name in names if name not in contacts.dtype.names]:
        raise RecordingError(f"{engine}: contacts lack the field {missing[0]}; make them as carom.record.CONTACT")
    found = np.zeros(len(np.atleast_1d(contacts)), CONTACT)
    for name in names:
        given = np.atleast_1d(contacts)[name]
        found[name] = whole_numbers(engine, f"{name} of contacts", given) if name in ("i", "j") else given
    for name in ("point", "normal", "force", "friction"):
        wrong = ~np.isfinite(found[name])
        if wrong.any():
            raise RecordingError(f"{engine}: contacts[{int(np.argwhere(wrong)[0][0])}] has a {name} that is not finite")
    first, last = np.minimum(found["i"], found["j"]), np.maximum(found["i"], found["j"])
    wrong = (first < 0) | (last >= ends) | (first >= bodies) | (first == last)
    if wrong.any():
        row = found[np.argmax(wrong)]
        raise RecordingError(
            f"{engine}: a contact has the numbers {row['i']} and {row['j']}; bodies are 0 to {bodies - 1}, planes up "
            f"to {ends - 1}"
        )
    length = np.linalg.norm(found["normal"], axis=1)
    wrong = np.abs(length - 1.0) > ROUGHLY
    if wrong.any():
        row = int(np.argmax(wrong))
        raise RecordingError(f"{engine}: the normal of contacts[{row}] has the length {length[row]:g}; it must be 1")
    return found


def rows_of_contacts(contacts: Records, step: int, time: float, dt: float) -> Records:
    """Return a row of the contact table for each pair, (k,) `CONTACT_ROW`, sorted by pair.

    Several contacts of a pair become one contact, with the total force, at the centre of the normal forces. The impulse
    is the force times the time (s) since the previous frame.
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
    one *= np.where(np.einsum("ij,ij->i", one, direction) < 0.0, -1.0, 1.0)[:, None]  # reversed if contacts attract
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
    """Return rows without impulses for the edges of a graph, used when an engine's contacts are invalid."""
    rows = np.zeros(len(graph), CONTACT_ROW)
    rows["step"], rows["time"], rows["mode"] = step, time, OPEN
    rows["i"], rows["j"] = graph.pairs.T
    point = position[rows["i"]] + radius[rows["i"]][:, None] * graph.normals
    for prefix, values in (("", point), ("n", graph.normals)):
        for axis, component in zip("xyz", values.T, strict=True):
            rows[f"{prefix}{axis}"] = component
    return rows


MARGIN = 0.02  # gap, in smaller radii, at which engines may already push bodies apart
TOUCH = 1e-3  # largest gap of touching bodies, in smaller radii


@dataclass(frozen=True, slots=True)
class EngineMoment:
    """A state whose arrays are complete."""

    time: float  # s
    position: FloatArray  # (n, 3) m
    velocity: FloatArray  # (n, 3) m/s
    spin: FloatArray  # (n, 3) rad/s, spins; (0, 3) if unknown
    orientation: FloatArray  # (n, 4) xyzw, orientations; (0, 4) if unknown
    force: FloatArray  # (n, 3) N, forces in the step that ends at this moment; (0, 3) if unknown
    torque: FloatArray  # (n, 3) N m, torques in the same step; (0, 3) if unknown

    def kinetic(self, setup: Setup) -> FloatArray:
        """Return the kinetic energy of every body, (n,) J."""
        energy = 0.5 * setup.mass * np.einsum("ij,ij->i", self.velocity, self.velocity)
        if len(self.spin):
            energy = energy + 0.5 * setup.inertia * np.einsum("ij,ij->i", self.spin, self.spin)
        return np.asarray(energy, dtype=np.float64)


@dataclass(frozen=True, slots=True)
class Near:
    """Pairs that may have touched since the previous moment: of bodies, or of a body and a plane (n or above)."""

    pairs: IntArray  # (k, 2) i < j; numbers of n and above are planes
    reach: FloatArray  # (k,) m, sum of the radii r_i + r_j
    small: FloatArray  # (k,) m, smaller radius of the pair
    before: FloatArray  # (k, 3) m, earlier vector from i to j; for a plane, from the centre to the plane
    now: FloatArray  # (k, 3) m, the present vector
    gap_before: FloatArray  # (k,) m, gap between the surfaces; negative where they overlap
    gap_now: FloatArray  # (k,) m
    normal: FloatArray  # (k, 3) present unit vectors from i to j
    relative_before: FloatArray  # (k, 3) m/s, velocity of j relative to i
    relative_now: FloatArray  # (k, 3) m/s

    def __len__(self) -> int:
        return len(self.pairs)

    @property
    def closing_now(self) -> FloatArray:
        """The present closing speeds along the present normals, (k,) m/s."""
        return np.asarray(-np.einsum("ij,ij->i", self.relative_now, self.normal))

    def normals_of_touch(self, bodies: int) -> FloatArray:
        """Return the normal for each pair with a plane (numbers from ``bodies`` on), else `directions_of_touch`."""
        plane = self.pairs[:, 1] >= bodies
        return np.where(plane[:, None], self.normal, self.directions_of_touch())

    def directions_of_touch(self) -> FloatArray:
        """Return the directions from i to j at first touch on straight paths, or at the smallest distance."""
        path = self.now - self.before
        a, b = np.einsum("ij,ij->i", path, path), np.einsum("ij,ij->i", self.before, path)
        c = np.einsum("ij,ij->i", self.before, self.before) - self.reach**2
        root = b * b - a * c
        moving = a > 0.0
        first = np.where(
            root > 0.0, (-b - np.sqrt(np.maximum(root, 0.0))) / np.where(moving, a, 1.0), -b / np.where(moving, a, 1.0)
        )
        at = self.before + np.where(moving, np.clip(first, 0.0, 1.0), 0.0)[:, None] * path
        length = lengths(at)[:, None]
        return np.asarray(np.where(length > 0.0, at / np.where(length > 0.0, length, 1.0), self.normal))

    def possible_normals(self, rows: IntArray) -> list[FloatArray]:
        """Return three normals (m, 3) that an engine may have used for some pairs: at touch, before, and now."""
        before = self.before[rows]
        earlier = before / np.maximum(lengths(before), np.finfo(float).tiny)[:, None]
        return [self.directions_of_touch()[rows], earlier, self.normal[rows]]

    def passed_deep(self) -> BoolArray:
        """Return a mask of the pairs whose straight paths overlap by more than a twentieth of the sum of radii."""
        path = self.now - self.before
        a = np.einsum("ij,ij->i", path, path)
        s = np.clip(-np.einsum("ij,ij->i", self.before, path) / np.where(a > 0.0, a, 1.0), 0.0, 1.0)
        return np.asarray(lengths(self.before + s[:, None] * path) < 0.95 * self.reach)


class Proximity:
    """Finds pairs of bodies and planes near each other."""

    def __init__(self, setup: Setup) -> None:
        self._setup = setup
        self._grid = HierarchicalGrid(setup.radius, setup.box) if setup.collides and len(setup) > 1 else None

    def between(self, before: EngineMoment, now: EngineMoment) -> Near:
        """Return the pairs that may have touched between two moments, or soon will."""
        setup, dt = self._setup, now.time - before.time
        moved = now.position - before.position
        drift = np.median(moved, axis=0)
        speed = lengths(moved - drift)
        # both velocities count, since engines may stop a body before it touches another
        for velocity in (before.velocity, now.velocity):
            speed = np.maximum(speed, lengths(velocity - np.median(velocity, axis=0)) * dt)
        parts = [self._bodies(before, now, speed)] if self._grid else []
        parts += [self._plane(k, before, now, speed) for k in range(len(setup.planes))] if setup.collides else []
        if not parts:
            numbers, vectors = np.empty(0), np.empty((0, 3))
            return Near(np.empty((0, 2), np.int64), *[numbers] * 2, *[vectors] * 2, *[numbers] * 2, *[vectors] * 3)
        names = [field.name for field in fields(Near)]
        return Near(**{name: np.concatenate([getattr(part, name) for part in parts]) for name in names})

    def graph(self, near: Near, known: IntArray | None) -> CollisionGraph:
        """Return the contacts at a moment: the pairs that the engine reports, or all near pairs if it reports none."""
        which = near.gap_now <= TOUCH * near.small
        if known is not None:
            total = len(self._setup) + len(self._setup.planes)
            low, high = np.sort(known, axis=1).T
            which = np.isin(near.pairs[:, 0] * total + near.pairs[:, 1], low * total + high)
        touching = np.flatnonzero(which)
        if len(touching) == 0:
            return empty_graph()
        pairs = near.pairs[touching]
        touching = touching[np.lexsort((pairs[:, 1], pairs[:, 0]))]
        colours = np.zeros(len(touching), dtype=np.int64)
        return CollisionGraph(near.pairs[touching], near.normal[touching], -near.gap_now[touching], colours)

    def graph_of_rows(self, rows: Records, position: FloatArray) -> CollisionGraph:
        """Return the graph of an engine's contacts, (m,) `CONTACT_ROW`, with the overlaps of the spheres."""
        if len(rows) == 0:
            return empty_graph()
        setup, n = self._setup, len(self._setup)
        pairs = np.stack([rows["i"], rows["j"]], axis=1)
        i, j, overlap = *pairs.T, np.empty(len(rows))
        plane = j >= n
        a, b = i[~plane], j[~plane]
        overlap[~plane] = setup.radius[a] + setup.radius[b] - lengths(self._image(position[b] - position[a]))
        a, k = i[plane], j[plane] - n
        height = np.einsum("ij,ij->i", position[a], setup.planes.normal[k]) - setup.planes.offset[k]
        overlap[plane] = setup.radius[a] - height
        normals = np.stack([rows["nx"], rows["ny"], rows["nz"]], axis=1)
        return CollisionGraph(pairs, normals, overlap, np.zeros(len(rows), dtype=np.int64))

    def _bodies(self, before: EngineMoment, now: EngineMoment, travel: FloatArray) -> Near:
        assert self._grid is not None
        radius = self._setup.radius
        pairs = self._grid.pairs(now.position, 1.0 + MARGIN, 4.0 * float(travel.max()))
        pairs = pairs[self._setup.touches[pairs].all(axis=1)]
        i, j = pairs.T
        apart = self._image(now.position[j] - now.position[i])
        reach = radius[i] + radius[j]
        distance = lengths(apart)
        gap = distance - reach
        small = np.minimum(radius[i], radius[j])
        close = np.flatnonzero(gap <= MARGIN * small + 2.0 * (travel[i] + travel[j]))
        i, j, apart, reach = i[close], j[close], apart[close], reach[close]
        earlier, distance = self._image(before.position[j] - before.position[i]), distance[close]
        return Near(
            pairs=pairs[close],
            reach=reach,
            small=small[close],
            before=earlier,
            now=apart,
            gap_before=lengths(earlier) - reach,
            gap_now=gap[close],
            normal=apart / np.where(distance > 0.0, distance, 1.0)[:, None],
            relative_before=before.velocity[j] - before.velocity[i],
            relative_now=now.velocity[j] - now.velocity[i],
        )

    def _plane(self, plane: int, before: EngineMoment, now: EngineMoment, travel: FloatArray) -> Near:
        setup = self._setup
        normal, offset = setup.planes.normal[plane], setup.planes.offset[plane]
        height = now.position @ normal - offset
        near = height - setup.radius <= MARGIN * setup.radius + 2.0 * travel
        close = np.flatnonzero(near & setup.touches)
        earlier, height, radius = before.position[close] @ normal - offset, height[close], setup.radius[close]
        return Near(
            pairs=np.stack((close, np.full(len(close), len(setup) + plane)), axis=1),
            reach=radius,
            small=radius,
            before=-earlier[:, None] * normal,
            now=-height[:, None] * normal,
            gap_before=earlier - radius,
            gap_now=height - radius,
            normal=np.tile(-normal, (len(close), 1)),
            relative_before=-before.velocity[close],
            relative_now=-now.velocity[close],
        )

    def _image(self, apart: FloatArray) -> FloatArray:
        """Return the differences of positions, to the nearest periodic image."""
        return minimum_images(apart, self._setup.box)


def lengths(vectors: FloatArray) -> FloatArray:
    """Return the length of each row."""
    return np.asarray(np.sqrt(np.einsum("ij,ij->i", vectors, vectors)))


def cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return a × b for vectors (3,) or rows of vectors; `numpy.cross` takes eight times as long for a few rows."""
    (x, y, z), (u, v, w) = a.T, b.T
    return np.ascontiguousarray(np.array([y * w - z * v, z * u - x * w, x * v - y * u]).T)


def rotated(orientation: FloatArray, vectors: FloatArray) -> FloatArray:
    """Rotate vectors (n, 3) from the bodies' frames into the world frame, by quaternions (n, 4) xyzw."""
    axis, w = orientation[:, :3], orientation[:, 3:]
    twice = 2.0 * cross(axis, vectors)
    return np.asarray(vectors + w * twice + cross(axis, twice))


def rotation_between(before: FloatArray, now: FloatArray) -> FloatArray:
    """Return the rotation vectors (n, 3) in the world frame between two sets of quaternions (n, 4), xyzw."""
    u, a = before[:, :3], before[:, 3]
    v, b = now[:, :3], now[:, 3]
    half = a[:, None] * v - b[:, None] * u - cross(v, u)
    cosine = a * b + np.einsum("ij,ij->i", u, v)
    sine = lengths(half)
    angle = 2.0 * np.arctan2(sine, np.abs(cosine))
    factor = np.where(sine > 0.0, angle / np.where(sine > 0.0, sine, 1.0), 2.0) * np.where(cosine < 0.0, -1.0, 1.0)
    return np.asarray(factor[:, None] * half)
