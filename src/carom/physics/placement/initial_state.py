"""Initial states of the bodies: explicit ones and those from data as given, then groups without overlaps."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from carom.errors import SceneError
from carom.physics.placement.check import (
    key_of,
    refuse_immersion,
    refuse_overflow,
    refuse_overlaps,
    refuse_unresolved,
    written_name,
)
from carom.physics.placement.growth import densest, grown, shrunken
from carom.physics.placement.lattice import lattice
from carom.physics.placement.neighbours import overlapping_pairs
from carom.physics.placement.plummer import drawn_velocities, mass_within
from carom.physics.placement.random_placement import positions
from carom.physics.placement.region import (
    default_region,
    half_extent,
    packing_fraction,
    plummer_lengths,
    refuse_too_large,
)
from carom.physics.placement.surroundings import Surroundings
from carom.scene.data.body_columns import BodyColumns
from carom.scene.key_places import naming_places
from carom.scene.matter import drawn_radii, made_of, mass_of, mean_volume
from carom.scene.schema import Body, BodyGroup, Region, Scene
from carom.scene.schema.body import LATTICES
from carom.scene.start import InitialBodies, half_spaces, join
from carom.scene.units.system import UnitSystem
from carom.scene.wording import NumberedNames

FloatArray = NDArray[np.float64]

MOST_FILLED = 0.7404  # packing of the densest lattices, π/√18
FULLEST = 0.38  # random sequential addition of equal spheres jams at 0.384 (Torquato & Stillinger, RMP 82, 2633)


def place(scene: Scene) -> InitialBodies:
    """Place all bodies of a scene. The same scene gives the same start.

    Raises
    ------
    SceneError
        If bodies of given positions overlap each other or a plane, which the scene does not allow, or a group does not
        fit.
    """
    with naming_places(scene):
        return _place(scene)


def _place(scene: Scene) -> InitialBodies:
    box = np.array(scene.domain.size) if scene.domain.boundary == "periodic" and scene.domain.size else None
    parts = [_given(scene)] if scene.body or scene.bodies else []
    if parts and scene.contact.enabled:
        reach = np.abs(parts[0].position).max(axis=1)
        worst = int(np.argmax(np.spacing(reach) / parts[0].radius))
        remedy, called = ", or set contact.enabled = false", written_name(scene, worst, parts[0].name)
        size, key = float(parts[0].radius[worst]), key_of(scene, worst)
        refuse_unresolved(called, key, float(reach[worst]), size, scene.unit_system, remedy)
    solids = half_spaces(scene)
    if parts and not scene.contact.allow_overlap and scene.contact.enabled:
        refuse_overlaps(scene, parts[0], box)
        refuse_immersion(scene, parts[0], solids)
    pull = 0.0 if scene.gravity.method == "none" else scene.gravity.constant
    streams = [np.random.default_rng(seed) for seed in np.random.SeedSequence(scene.seed).spawn(len(scene.group))]
    _refuse_full_box(scene)
    units = scene.unit_system
    centres: dict[int, FloatArray] = {}  # of groups that were compressed together with an earlier one
    radii: dict[int, FloatArray] = {}
    for index, group in enumerate(scene.group):
        if index not in centres:
            mixture = _mixture(scene, index)
            radii |= {member: drawn_radii(scene.group[member], streams[member]) for member in mixture}
            spheres = [(part.position, part.radius) for part in parts]
            spheres += [(centres[member], radii[member]) for member in centres if member > index]
            around = Surroundings(tuple(spheres), solids, box)
            region = _region(mixture, radii, units)
            radius = np.concatenate([radii[member] for member in mixture])
            position = _arranged(mixture, region, radius, around, streams[index], units)
            ends = np.cumsum([len(radii[member]) for member in mixture])[:-1]
            centres |= dict(zip(mixture, np.split(position, ends), strict=True))
        made = made_of(scene, group)
        region = group.region or default_region(index, radii[index], units)
        parts.append(_group(index, made, region, radii[index], centres[index], streams[index], pull))
    start = join(parts)
    refuse_overflow(start)
    return start if box is None else replace(start, position=_inside(start.position, box))


def _inside(position: FloatArray, box: FloatArray) -> FloatArray:
    """Return the images of positions inside a periodic box; those of its own results are the same bits."""
    half = 0.5 * box
    turns = np.where(np.abs(position) > half, np.floor(position / box + 0.5), 0.0)
    return np.clip(position - box * turns, -half, half)  # rounding may leave an image an ulp outside, to turn again


def _given(scene: Scene) -> InitialBodies:
    """Return the bodies whose positions are given, in the order of the scene."""
    parts = [_explicit([made_of(scene, body) for body in scene.body])] if scene.body else []
    for index, columns in enumerate(scene.data):
        first = sum(len(part.mass) for part in parts)
        parts.append(_from_data(-2 - index, scene.bodies[index].name, columns, first))
    return parts[0] if len(parts) == 1 else join(parts)


def _from_data(group: int, name: str, columns: BodyColumns, first: int) -> InitialBodies:
    """Return the bodies of a [[bodies]]; ``first`` is the number of the first in the scene."""
    n = len(columns)
    numbered = NumberedNames(name, n) if name else NumberedNames("body", n, first)
    return InitialBodies(
        name=[own or numbered[row] for row, own in enumerate(columns.name)] if columns.name else numbered,
        group=np.full(n, group),
        position=columns.position,
        velocity=columns.velocity,
        angular_velocity=columns.angular_velocity,
        mass=columns.mass,
        radius=columns.radius,
        inertia=columns.inertia,
        fixed=columns.fixed,
    )


def _explicit(bodies: Sequence[Body]) -> InitialBodies:
    radius = np.array([body.radius for body in bodies])
    factor = np.array([body.inertia_ratio for body in bodies])
    mass = np.array([mass_of(body, np.array(body.radius)) for body in bodies])
    return InitialBodies(
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


def _mixture(scene: Scene, index: int) -> dict[int, BodyGroup]:
    """Return the groups that are placed together with a group, which is the first of them, by their indices.

    Groups that are compressed into one region grow together. One after the other, the first would leave no space for
    the next.
    """
    first = scene.group[index]
    if first.arrangement != "compressed" or first.region is None:
        return {index: first}
    alike = (first.arrangement, first.region)
    groups = list(enumerate(scene.group))[index:]
    return {k: group for k, group in groups if (group.arrangement, group.region) == alike}


def _region(mixture: Mapping[int, BodyGroup], radii: Mapping[int, FloatArray], units: UnitSystem) -> Region:
    """Return the region of a mixture; refuse it if it is too small, or too far away for the radii."""
    index, group = next(iter(mixture.items()))
    if group.arrangement not in LATTICES:
        _refuse_full_region(mixture, radii)
    region = group.region or default_region(index, radii[index], units)
    reach = max(map(abs, region.centre)) + float(half_extent(region).max())
    for member in mixture:
        refuse_unresolved(f"group.{member}", ("group", member), reach, float(radii[member].min()), units)
    return region


def _group(
    index: int,
    group: BodyGroup,
    region: Region,
    radius: FloatArray,
    position: FloatArray,
    rng: np.random.Generator,
    constant: float,
) -> InitialBodies:
    """Return the bodies of a group that has been placed."""
    n = group.count
    mass = np.broadcast_to(mass_of(group, radius), (n,)).astype(np.float64)
    rotation = np.array(group.bulk_rotation)
    velocity = np.array(group.velocity.mean) + group.velocity.dispersion * rng.standard_normal((n, 3))
    velocity = velocity + np.cross(rotation, position - np.array(region.centre))
    if group.velocity.virial is not None:
        if constant == 0.0:
            raise SceneError(
                f"group.{index}.velocity.virial without gravity of the bodies; set gravity.constant, or leave it out",
                ("group", index, "velocity", "virial"),
            )
        scale, cut = plummer_lengths(region)
        distance = np.sqrt(((position - np.array(region.centre)) ** 2).sum(axis=1))
        whole = constant * float(mass.sum()) / mass_within(cut, scale)
        velocity = velocity + drawn_velocities(distance, scale, whole, group.velocity.virial, rng)
    name = group.name or f"group {index}"
    return InitialBodies(
        name=[f"{name} {k}" for k in range(n)],
        group=np.full(n, index),
        position=position,
        velocity=velocity,
        angular_velocity=rotation + group.spin.dispersion * rng.standard_normal((n, 3)),
        mass=mass,
        radius=radius,
        inertia=group.inertia_ratio * mass * radius * radius,
        fixed=np.zeros(n, dtype=bool),
    )


def _arranged(
    mixture: Mapping[int, BodyGroup],
    region: Region,
    radius: FloatArray,
    around: Surroundings,
    rng: np.random.Generator,
    units: UnitSystem,
) -> FloatArray:
    """Return the centres of a mixture, (n, 3) m."""
    index, group = next(iter(mixture.items()))
    if group.arrangement in LATTICES:

        def is_clear(points: FloatArray) -> NDArray[np.bool_]:
            return around.is_clear(points, np.full(len(points), radius.max()))

        found = lattice(index, group, region, radius, is_clear, units)
        if around.box is not None and len(overlapping_pairs(found, radius, around.box)):
            raise SceneError(
                f"group.{index}.region: bodies of the lattice meet across the periodic boundary; make the region "
                "smaller than the box by a spacing",
                ("group", index, "region"),
            )
        return found
    refuse_too_large(index, region, radius, units)
    if group.arrangement == "random":
        return positions(index, region, radius, around, rng)
    packing = sum(map(packing_fraction, mixture.values()))
    loose = positions(index, region, shrunken(radius, packing), around, rng, dense=True)
    return grown(index, region, loose, radius, packing, around, rng)


def _refuse_full_region(mixture: Mapping[int, BodyGroup], radii: Mapping[int, FloatArray]) -> None:
    """Refuse a region that a mixture would fill more than its arrangement can."""
    index, group = next(iter(mixture.items()))
    if group.region is None:
        return
    radius = np.concatenate([radii[member] for member in mixture])
    packing, way_out = sum(map(packing_fraction, mixture.values())), ""
    if group.arrangement == "compressed":
        fullest, jams = densest(radius), "compression of these radii goes up to"
    else:
        fullest, jams = FULLEST, "random placement jams at"
        if packing <= densest(radius) and group.region.shape != "plummer":
            way_out = ', or set arrangement = "compressed"'
    if packing > fullest:
        others = "".join(f" with group.{member}" for member in mixture if member != index)
        raise SceneError(
            f"group.{index}.region is too small: {len(radius)} bodies{others} would fill {packing:.3g} of it, and "
            f"{jams} {fullest:.3g}; enlarge the region or lower count or radius{way_out}",
            ("group", index, "region"),
        )


def _refuse_full_box(scene: Scene) -> None:
    """Refuse groups that do not fit into a periodic box or between walls, however large their regions are."""
    if scene.domain.boundary == "open" or scene.domain.size is None or not scene.group:
        return
    filled = sum(mean_volume(group) * group.count for group in scene.group) / math.prod(scene.domain.size)
    if all(group.arrangement == "random" for group in scene.group):
        fullest, reason = FULLEST, "random placement jams at"
    else:
        fullest, reason = MOST_FILLED, "no arrangement of equal spheres fills more than"
    if filled > fullest:
        raise SceneError(
            f"domain.size: the groups would fill {filled:.3g} of the box, and {reason} "
            f"{fullest:.4g}; enlarge the box or lower count or radius",
            ("domain", "size"),
        )
