"""Initial states of the bodies: explicit ones as written, groups at random without overlaps.

Groups are placed by generating 1.2 n candidates and filtering them: a broad phase by k-d trees, then the exact test.
Candidates that collide are replaced by new ones until n are accepted.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from carom.scene.error import SceneError
from carom.scene.half_space import HalfSpaces, half_spaces
from carom.scene.names import body_called, body_key
from carom.scene.neighbours import (
    QUERY_MARGIN,
    overlapping_pairs,
    size_classes,
    squared_distance,
    wrapped,
)
from carom.scene.portable_math import cube_root, power
from carom.scene.schema import LARGEST, Body, Group, Region, Scene

if TYPE_CHECKING:
    from scipy.spatial import cKDTree

FloatArray = NDArray[np.float64]

CANDIDATES_PER_BODY = 1.2
MOST_ROUNDS = 400  # of generating and filtering, for one size class
MOST_DRAWN = 50_000_000  # candidates, for one size class
FULLEST = 0.38  # random sequential addition of equal spheres jams at 0.384 (Torquato & Stillinger, RMP 82, 2633)
DEFAULT_PACKING = 0.1  # of a group without a region
DEFAULT_DENSITY = 1000.0  # kg/m³


@dataclass(frozen=True)
class Start:
    """The bodies at time 0, explicit ones first, then the groups in order; SI units."""

    name: list[str]
    group: NDArray[np.int64]  # (n,) index of the group, -1 for explicit bodies
    position: FloatArray  # (n, 3)
    velocity: FloatArray  # (n, 3)
    angular_velocity: FloatArray  # (n, 3)
    mass: FloatArray  # (n,)
    radius: FloatArray  # (n,)
    inertia: FloatArray  # (n,)
    fixed: NDArray[np.bool_]  # (n,)


def place(scene: Scene) -> Start:
    """Place all bodies of a scene. The same scene gives the same start.

    Raises
    ------
    SceneError
        If explicit bodies overlap each other or a plane and the scene does not allow it, or a group does not fit.
    """
    box = np.array(scene.domain.size) if scene.domain.boundary == "periodic" and scene.domain.size else None
    parts = [_explicit(scene.body)] if scene.body else []
    if parts and scene.contact.enabled:
        reach = np.abs(parts[0].position).max(axis=1)
        worst = int(np.argmax(np.spacing(reach) / parts[0].radius))
        remedy, key = ", or set contact.enabled = false", body_key(worst, parts[0].name[worst])
        _refuse_unresolved(key, float(reach[worst]), float(parts[0].radius[worst]), remedy)
    solids = half_spaces(scene)
    if parts and not scene.contact.allow_overlap and scene.contact.enabled:
        _refuse_overlaps(parts[0], box)
        _refuse_immersion(parts[0], solids)
    streams = np.random.SeedSequence(scene.seed).spawn(len(scene.group))
    _refuse_full_box(scene)
    for index, group in enumerate(scene.group):
        parts.append(_group(index, group, parts, solids, box, np.random.default_rng(streams[index])))
    start = _join(parts)
    _refuse_overflow(start)
    return start if box is None else replace(start, position=_inside(start.position, box))


def _inside(position: FloatArray, box: FloatArray) -> FloatArray:
    """Return the images of positions inside a periodic box."""
    turns = np.where(np.abs(position) > 0.5 * box, np.floor(position / box + 0.5), 0.0)
    return np.asarray(position - box * turns)


def packing_fraction(group: Group) -> float:
    """Return the expected volume of a group's spheres over the volume of its region."""
    if group.region is None:
        return DEFAULT_PACKING
    return _mean_volume(group) * group.count / _region_volume(group.region)


def _explicit(bodies: tuple[Body, ...]) -> Start:
    radius = np.array([body.radius for body in bodies])
    factor = np.array([body.inertia_factor for body in bodies])
    mass = np.array([_mass(body, np.array(body.radius)) for body in bodies])
    return Start(
        name=[body.name or f"body {index}" for index, body in enumerate(bodies)],
        group=np.full(len(bodies), -1),
        position=np.array([body.position for body in bodies]),
        velocity=np.array([body.velocity for body in bodies]),
        angular_velocity=np.array([body.angular_velocity for body in bodies]),
        mass=mass,
        radius=radius,
        inertia=factor * mass * radius * radius,
        fixed=np.array([body.fixed for body in bodies]),
    )


def _refuse_unresolved(key: str, reach: float, radius: float, remedy: str = "") -> None:
    """Refuse bodies smaller than the spacing of floating-point numbers at their positions; lengths in m."""
    step = float(np.spacing(reach))
    if step > radius:
        raise SceneError(
            f"{key}: {reach:.3g} m from the origin, positions are {step:.3g} m apart, and the radius is "
            f"{radius:.3g} m; place it nearer to the origin or enlarge the radius{remedy}"
        )


def _refuse_full_box(scene: Scene) -> None:
    """Refuse groups that do not fit into a periodic box or between walls, however large their regions are."""
    if scene.domain.boundary == "open" or scene.domain.size is None or not scene.group:
        return
    filled = sum(_mean_volume(group) * group.count for group in scene.group) / math.prod(scene.domain.size)
    if filled > FULLEST:
        raise SceneError(
            f"domain.size: the groups would fill {filled:.3g} of the box, and random placement jams at "
            f"{FULLEST}; enlarge the box or lower count or radius"
        )


def _refuse_overflow(start: Start) -> None:
    """Refuse bodies whose mass, moment of inertia or motion overflows or underflows."""
    with np.errstate(over="ignore", divide="ignore"):
        wrong = {
            "mass": ~(np.isfinite(start.mass) & np.isfinite(1.0 / start.mass)),
            "moment of inertia": ~(np.isfinite(start.inertia) & np.isfinite(1.0 / start.inertia)),
            "velocity": ~np.isfinite(start.velocity).all(axis=1),
            "angular velocity": ~np.isfinite(start.angular_velocity).all(axis=1),
        }
    for what, bodies in wrong.items():
        if bodies.any():
            worst = int(np.argmax(bodies))
            called = body_called(worst, start.name[worst])
            raise SceneError(f"the {what} of {called} is too large or too small a number; choose other units")


def _refuse_overlaps(start: Start, box: FloatArray | None) -> None:
    """Refuse overlapping bodies; touching is allowed, up to the rounding of the positions."""
    pairs = overlapping_pairs(start.position, start.radius, box)
    if len(pairs) == 0:
        return
    i, j = pairs.T
    reach = start.radius[i] + start.radius[j]
    distance = np.sqrt(squared_distance(start.position[i], start.position[j], box))
    rounding = _rounding(start, reach)
    worst = int(np.argmax(reach - distance - rounding))
    overlap = reach[worst] - distance[worst]
    if overlap > rounding[worst]:
        a, b = pairs[worst]
        raise SceneError(
            f"{body_key(a, start.name[a])} and {body_key(b, start.name[b])} overlap by {overlap:.6g} m at the start; "
            "move them apart, or set contact.allow_overlap = true"
        )


def _refuse_immersion(start: Start, solids: HalfSpaces) -> None:
    depth = solids.depth(start.position, start.radius)
    rounding = _rounding(start, start.radius)[:, None]
    if len(solids) and np.max(depth - rounding) > 0.0:
        body, plane = np.unravel_index(np.argmax(depth - rounding), depth.shape)
        raise SceneError(
            f"{body_key(int(body), start.name[body])} reaches {depth[body, plane]:.6g} m into {solids.name[plane]} "
            "at the start; move it out, or set contact.allow_overlap = true"
        )


def _rounding(start: Start, length: FloatArray) -> FloatArray:
    """Return the possible rounding errors of lengths, in m."""
    return np.asarray(1e-9 * length + 4 * np.spacing(np.abs(start.position).max()))


def _group(
    index: int,
    group: Group,
    placed: list[Start],
    solids: HalfSpaces,
    box: FloatArray | None,
    rng: np.random.Generator,
) -> Start:
    packing = packing_fraction(group)
    if packing > FULLEST:
        raise SceneError(
            f"group.{index}.region is too small: {group.count} bodies would fill {packing:.3g} of it, and random "
            f"placement jams at {FULLEST}; enlarge the region or lower count or radius"
        )
    n = group.count
    radius = _radii(group, rng)
    region = group.region or _default_region(index, radius)
    room = region.radius if region.radius is not None else 0.5 * max(region.size or ())
    _refuse_unresolved(f"group.{index}", max(map(abs, region.centre)) + room, float(radius.min()))
    position = _positions(index, region, radius, placed, solids, box, rng)
    mass = np.broadcast_to(_mass(group, radius), (n,)).astype(np.float64)
    rotation = np.array(group.bulk_rotation)
    velocity = np.array(group.velocity.mean) + group.velocity.dispersion * rng.standard_normal((n, 3))
    velocity = velocity + np.cross(rotation, position - np.array(region.centre))
    name = group.name or f"group {index}"
    return Start(
        name=[f"{name} {k}" for k in range(n)],
        group=np.full(n, index),
        position=position,
        velocity=velocity,
        angular_velocity=rotation + group.spin.dispersion * rng.standard_normal((n, 3)),
        mass=mass,
        radius=radius,
        inertia=group.inertia_factor * mass * radius * radius,
        fixed=np.zeros(n, dtype=bool),
    )


def body_mass(body: Body) -> float:
    """Return the mass of a body in kg."""
    return float(_mass(body, np.array(body.radius)))


def mean_mass(group: Group) -> float:
    """Return the expected mass of a body of a group in kg."""
    if group.mass is not None:
        return group.mass
    return (DEFAULT_DENSITY if group.density is None else group.density) * _mean_volume(group)


@np.errstate(over="ignore")
def _mass(matter: Body | Group, radius: FloatArray) -> FloatArray:
    if matter.mass is not None:
        return np.asarray(matter.mass)
    density = DEFAULT_DENSITY if matter.density is None else matter.density
    return np.asarray(density * (4.0 / 3.0) * math.pi * radius * radius * radius)


def _radii(group: Group, rng: np.random.Generator) -> FloatArray:
    """Draw radii by inverting the cumulative distribution."""
    low, high = group.radius.min, group.radius.max
    u = rng.random(group.count)
    if low == high:
        return np.full(group.count, low)
    if group.radius.distribution == "uniform":
        return low + (high - low) * u
    p = group.radius.exponent + 1.0
    if group.radius.distribution == "log-uniform" or p == 0.0:
        return np.asarray(np.clip(low * power(np.array(high / low), u), low, high))
    return np.asarray(np.clip(low * power(1 + u * (power(np.array(high / low), p) - 1), 1 / p), low, high))


def _mean_volume(group: Group) -> float:
    """Return the mean volume of a sphere of the group, from a fixed sample of the radius distribution."""
    sample = group.model_copy(update={"count": 4096})
    radius = _radii(sample, np.random.default_rng(0))
    return float(np.mean((4.0 / 3.0) * math.pi * radius * radius * radius))


def _region_volume(region: Region) -> float:
    if region.radius is not None:
        return 4.0 / 3.0 * math.pi * region.radius**3
    return math.prod(region.size or ())


def _default_region(index: int, radius: FloatArray) -> Region:
    """Return a ball that is `DEFAULT_PACKING` full."""
    with np.errstate(over="ignore"):
        volume = np.asarray(np.sum(radius * radius * radius) / DEFAULT_PACKING)
        room = float(max(cube_root(volume), 1.01 * radius.max()))
    if room > LARGEST:
        raise SceneError(f"group.{index}: bodies so large need a region of more than {LARGEST:g} m; lower the radius")
    return Region(radius=room)


def _positions(
    index: int,
    region: Region,
    radius: FloatArray,
    placed: list[Start],
    solids: HalfSpaces,
    box: FloatArray | None,
    rng: np.random.Generator,
) -> FloatArray:
    """Place spheres of given radii, the largest size class first, so that small ones fill the gaps."""
    from scipy.spatial import cKDTree  # noqa: PLC0415 - slow to import, and not always needed

    _refuse_too_large(index, region, radius)
    packing = float(np.sum((4.0 / 3.0) * math.pi * radius * radius * radius)) / _region_volume(region)
    position = np.empty((len(radius), 3))
    obstacles = [(start.position, start.radius) for start in placed]
    for members in reversed(size_classes(radius)):
        trees = [
            (cKDTree(wrapped(centres[same], box), boxsize=box), centres[same], radii[same])
            for centres, radii in obstacles
            for same in size_classes(radii)
        ]
        position[members] = _place_class(index, region, radius[members], trees, solids, box, rng, packing)
        obstacles.append((position[members], radius[members]))
    return position


_Tree = tuple["cKDTree", FloatArray, FloatArray]


def _place_class(
    index: int,
    region: Region,
    radius: FloatArray,
    trees: list[_Tree],
    solids: HalfSpaces,
    box: FloatArray | None,
    rng: np.random.Generator,
    packing: float,
) -> FloatArray:
    """Generate and filter one size class.

    The pool keeps the order of arrival, and of two candidates that collide the newer one is removed. An accepted
    candidate therefore stays, and no round loses one. Each round tops the pool up to 1.2 n. ``owner`` is the body whose
    radius a candidate has; only the first accepted candidate of each body is kept.
    """
    n = len(radius)
    pool, owner, missing = np.empty((0, 3)), np.empty(0, dtype=np.int64), np.arange(n)
    drawn = 0
    for _ in range(MOST_ROUNDS):
        if drawn > MOST_DRAWN:
            break
        drawn += math.ceil(CANDIDATES_PER_BODY * n) - len(owner)
        fresh_owner = np.resize(missing, math.ceil(CANDIDATES_PER_BODY * n) - len(owner))
        fresh = _draw(region, radius[fresh_owner], rng)
        clear = _clear_of(fresh, radius[fresh_owner], trees, solids, box)
        pool = np.concatenate((pool, fresh[clear]))
        owner = np.concatenate((owner, fresh_owner[clear]))
        pairs = overlapping_pairs(pool, radius[owner], box) if len(pool) else np.empty((0, 2), dtype=np.int64)
        clean = np.setdiff1d(np.arange(len(pool)), pairs[:, 1])
        _, first = np.unique(owner[clean], return_index=True)
        kept = clean[np.sort(first)]
        pool, owner = pool[kept], owner[kept]
        missing = np.setdiff1d(np.arange(n), owner)
        if len(missing) == 0:
            return pool[np.argsort(owner)]
    in_the_way = np.flatnonzero(np.all(solids.depth(fresh, radius[fresh_owner]) >= 0.0, axis=0))
    if len(in_the_way):
        names = " and ".join(solids.name[plane] for plane in in_the_way)
        raise SceneError(f"group.{index}.region: no room for the bodies outside {names}; move the region or enlarge it")
    raise SceneError(
        f"group.{index}: {len(missing)} of {n} bodies found no room within {MOST_ROUNDS} rounds of "
        f"placement (packing fraction {packing:.3g}); enlarge the region or lower count or radius"
    )


def _draw(region: Region, radius: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Draw centres uniformly so that every sphere lies inside the region."""
    n = len(radius)
    if region.radius is not None:
        direction = rng.standard_normal((n, 3))
        direction /= np.linalg.norm(direction, axis=1, keepdims=True)
        offset = direction * ((region.radius - radius) * cube_root(rng.random(n)))[:, None]
    else:
        offset = (rng.random((n, 3)) - 0.5) * (np.array(region.size) - 2 * radius[:, None])
    return np.array(region.centre) + offset


def _clear_of(
    position: FloatArray, radius: FloatArray, trees: list[_Tree], solids: HalfSpaces, box: FloatArray | None
) -> NDArray[np.bool_]:
    """Tell which candidates touch no plane and none of the bodies placed before."""
    from scipy.spatial import cKDTree  # noqa: PLC0415 - slow to import, and not always needed

    clear: NDArray[np.bool_] = np.all(solids.depth(position, radius) < 0.0, axis=1)
    own = cKDTree(wrapped(position, box), boxsize=box)
    for tree, centres, radii in trees:
        reach = (radius.max() + radii.max()) * QUERY_MARGIN
        near = own.sparse_distance_matrix(tree, reach, output_type="ndarray")
        i, j = near["i"], near["j"]
        hit = squared_distance(position[i], centres[j], box) <= (radius[i] + radii[j]) ** 2
        clear[i[hit]] = False
    return clear


def _refuse_too_large(index: int, region: Region, radius: FloatArray) -> None:
    room = region.radius if region.radius is not None else min(region.size or ()) / 2
    if radius.max() > room:
        raise SceneError(
            f"group.{index}: a body of radius {radius.max():g} m does not fit into its region; enlarge the region"
        )


def _join(parts: list[Start]) -> Start:
    def stacked(key: str) -> NDArray[np.float64]:
        return np.ascontiguousarray(np.concatenate([getattr(part, key) for part in parts]))

    return Start(
        name=[name for part in parts for name in part.name],
        group=np.concatenate([part.group for part in parts]),
        position=stacked("position"),
        velocity=stacked("velocity"),
        angular_velocity=stacked("angular_velocity"),
        mass=stacked("mass"),
        radius=stacked("radius"),
        inertia=stacked("inertia"),
        fixed=np.concatenate([part.fixed for part in parts]),
    )
