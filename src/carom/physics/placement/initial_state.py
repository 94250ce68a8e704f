"""Initial states of the bodies: explicit bodies and bodies from data as given, then groups without overlaps."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from carom import registry
from carom.arrays import FloatArray
from carom.errors import SceneError
from carom.physics.contact.solid_records import solids_of
from carom.physics.placement.neighbours import Surroundings, overlapping_pairs, squared_distance
from carom.physics.placement.random_placement import FULLEST, scattered
from carom.physics.placement.region import (
    Arrange,
    arrangement_called,
    default_region,
    half_extent,
    packing_fraction,
    plummer,
    plummer_lengths,
)
from carom.physics.placement.wall_clearance import refuse_crossing_walls
from carom.plan.room import refuse_small_memory
from carom.plan.step_parts import refusals_of
from carom.registry import imported
from carom.scene.explanation import naming_places
from carom.scene.load import Scene
from carom.scene.matter import drawn_radii, made_of, mass_of, mean_volume
from carom.scene.scene_file import KeyPath
from carom.scene.schema import Body, BodyGroup, Region
from carom.scene.start import HalfSpaces, InitialBodies, join
from carom.scene.units.dimension import LENGTH
from carom.scene.units.system import UnitSystem
from carom.scene.wording import NumberedNames, body_called, body_key

MOST_FILLED = 0.7404  # packing fraction of the densest lattices, π/√18


def place(scene: Scene) -> InitialBodies:
    """Place all bodies of a scene. The same scene gives the same initial state.

    Raises
    ------
    SceneError
        If the memory is too small, a group does not fit, or bodies with given positions overlap each other or a plane
        although the scene does not allow it.
    """
    with naming_places(scene):
        refuse_small_memory(scene)
        box = None if scene.domain.period is None else np.array(scene.domain.period)
        parts = [_given(scene)] if scene.body or scene.bodies else []
        if parts and scene.contact.enabled:
            reach = np.abs(parts[0].position).max(axis=1)
            worst = int(np.argmax(np.spacing(reach) / parts[0].radius))
            remedy, called = ", or set contact.enabled = false", written_name(scene, worst, parts[0].name)
            size, key = float(parts[0].radius[worst]), key_of(scene, worst)
            refuse_unresolved(called, key, float(reach[worst]), size, scene.unit_system, remedy)
        solids = solids_of(scene)
        if parts and scene.wall:
            refuse_outside(scene, parts[0], solids)
        if parts and not scene.contact.allow_overlap and scene.contact.enabled:
            refuse_overlaps(scene, parts[0], box)
            refuse_immersion(scene, parts[0], solids)
        pull = 0.0 if scene.gravity.method == "none" else scene.gravity.constant
        streams = [np.random.default_rng(seed) for seed in np.random.SeedSequence(scene.seed).spawn(len(scene.group))]
        _refuse_full_box(scene)
        units = scene.unit_system
        centres: dict[int, FloatArray] = {}  # centres of groups that were compressed together with an earlier group
        radii: dict[int, FloatArray] = {}
        for index, group in enumerate(scene.group):
            if index not in centres:
                mixture = _mixture(scene, index)
                radii |= {member: drawn_radii(scene.group[member], streams[member]) for member in mixture}
                # bodies that enter later do not exist yet, and look for a free place when they enter
                there = [part for part in parts if not _enters(scene, part)] if group.release is None else []
                spheres = [(part.position, part.radius) for part in there]
                spheres += [
                    (centres[member], radii[member])
                    for member in centres
                    if member > index and group.release is None and scene.group[member].release is None
                ]
                around = Surroundings(tuple(spheres), solids, box)
                region = _region(mixture, radii, units)
                radius = np.concatenate([radii[member] for member in mixture])
                arrange = _arrange(group)
                try:
                    position = arrange(mixture, region, radius, around, streams[index], units)
                except SceneError:  # without a region in the scene, bodies may fill the whole domain
                    if group.region is not None or scene.domain.size is None or "open" in scene.domain.axes:
                        raise
                    whole = Region(shape="box", size=scene.domain.size)
                    filling = {index: group.model_copy(update={"region": whole})}
                    position = arrange(filling, whole, radius, around, streams[index], units)
                ends = np.cumsum([len(radii[member]) for member in mixture])[:-1]
                centres |= dict(zip(mixture, np.split(position, ends), strict=True))
            made = made_of(scene, group)
            region = group.region or default_region(index, radii[index], units)
            parts.append(_group(index, made, region, radii[index], centres[index], streams[index], pull))
        start = join(parts)
        refuse_overflow(start)
        for refusals in refusals_of(scene):
            imported(refusals)(scene, start, solids)
        if scene.contact.enabled:
            refuse_crossing_walls(scene, start, solids)
        return start if box is None else _inside(scene, start, box)


def _enters(scene: Scene, part: InitialBodies) -> bool:
    """Return whether the bodies of a part enter during the run; the bodies of a group are one part."""
    group = int(part.group[0])
    return group >= 0 and scene.group[group].release is not None


def _arrange(group: BodyGroup) -> Arrange:
    """Return the arrangement that places a group: bodies that enter one by one may share a place."""
    if group.arrangement == "random" and group.release is not None and group.release.rate is not None:
        return scattered
    return arrangement_called(group.arrangement).arrange


def _inside(scene: Scene, start: InitialBodies, box: FloatArray) -> InitialBodies:
    """Return bodies with the images of their positions inside a periodic box; positions inside keep their bits."""
    half, velocity = 0.5 * box, start.velocity
    images = np.where(np.abs(start.position) > half, np.floor(start.position / box + 0.5), 0.0)
    position = np.clip(start.position - box * images, -half, half)  # rounding may put an image an ulp outside
    if scene.domain.shear:  # groups move with the flow, images with the box
        flow, gradient = scene.domain.shear.axes
        carried = np.where(start.group >= 0, start.position[:, gradient], 0.0) - box[gradient] * images[:, gradient]
        velocity = velocity.copy()
        velocity[:, flow] += scene.domain.shear.rate * carried
    return replace(start, position=position, velocity=velocity)


def _given(scene: Scene) -> InitialBodies:
    """Return the bodies with given positions, in the order of the scene."""
    parts = [_explicit([made_of(scene, body) for body in scene.body])] if scene.body else []
    for index, columns in enumerate(scene.data):
        first = sum(len(part.mass) for part in parts)
        name, n = scene.bodies[index].name, len(columns)
        numbered = NumberedNames(name, n) if name else NumberedNames("body", n, first)
        parts.append(
            InitialBodies(
                name=[own or numbered[row] for row, own in enumerate(columns.name)] if columns.name else numbered,
                group=np.full(n, -2 - index),
                position=columns.position,
                velocity=columns.velocity,
                angular_velocity=columns.angular_velocity,
                mass=columns.mass,
                radius=columns.radius,
                inertia=columns.inertia,
                fixed=columns.fixed,
            )
        )
    return parts[0] if len(parts) == 1 else join(parts)


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

    Groups compressed into the same region grow together. If they were compressed one after another, the first would
    leave no space for the next.
    """
    first = scene.group[index]
    if first.arrangement != "compressed" or first.region is None:
        return {index: first}
    alike = (first.arrangement, first.region, first.release)
    groups = list(enumerate(scene.group))[index:]
    return {k: group for k, group in groups if (group.arrangement, group.region, group.release) == alike}


def _region(mixture: Mapping[int, BodyGroup], radii: Mapping[int, FloatArray], units: UnitSystem) -> Region:
    """Return the region of a mixture; refuse it if it is too small, or too far away for the radii."""
    index, group = next(iter(mixture.items()))
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
                f"group.{index}.velocity.virial needs gravity between the bodies; set gravity.constant, or remove the "
                "key",
                ("group", index, "velocity", "virial"),
            )
        model, (scale, cut) = plummer(), plummer_lengths(region)
        distance = np.sqrt(((position - np.array(region.centre)) ** 2).sum(axis=1))
        whole = constant * float(mass.sum()) / model.mass_within(cut, scale)
        velocity = velocity + model.drawn_velocities(distance, scale, whole, group.velocity.virial, rng)
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


def _refuse_full_region(mixture: Mapping[int, BodyGroup], radii: Mapping[int, FloatArray]) -> None:
    """Refuse a region that a mixture would fill beyond the limit of its arrangement."""
    index, group = next(iter(mixture.items()))
    if group.region is None or (group.release is not None and group.release.rate is not None):
        return
    radius = np.concatenate([radii[member] for member in mixture])
    arrangement = arrangement_called(group.arrangement)
    fullest = arrangement.fullest(radius)
    if math.isinf(fullest):
        return
    packing, remedy = sum(map(packing_fraction, mixture.values())), ""
    if packing > fullest:
        can_be_compressed = group.region.shape != "plummer" and "compressed" in registry.names("placements")
        if can_be_compressed and packing <= arrangement_called("compressed").fullest(radius):
            remedy = ', or set arrangement = "compressed"'
        others = "".join(f" with group.{member}" for member in mixture if member != index)
        raise SceneError(
            f"group.{index}.region is too small: {len(radius)} bodies{others} would fill {packing:.3g} of it, and "
            f"{arrangement.limit} {fullest:.3g}; enlarge the region or lower count or radius{remedy}",
            ("group", index, "region"),
        )


def _refuse_full_box(scene: Scene) -> None:
    """Refuse groups that do not fit into a periodic box or between walls, whatever the size of their regions."""
    if "open" in scene.domain.axes or scene.domain.size is None or not scene.group:
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


# checks of initial states: overlaps, and numbers out of range
MOST_PAIRS = 3  # largest number of pairs that a message names
WRITTEN = 5e-7  # half a unit in the last of seven digits: files and people write at least seven
MOST_WRITTEN = 1e-3  # largest overlap, in radii, that may be due to the rounding of a file


def key_of(scene: Scene, number: int) -> KeyPath:
    """Return the key of a body with a given position, or of the data that contain it."""
    row = number - len(scene.body)
    if row < 0:
        return "body", number
    ends = np.cumsum([len(columns) for columns in scene.data])
    return "bodies", int(np.searchsorted(ends, row, side="right"))


def written_name(scene: Scene, number: int, names: Sequence[str]) -> str:
    """Return the name, for messages, of a body with a given position: its key in the scene, or its row in the data."""
    return "".join(_place_of(scene, number, names))


def _place_of(scene: Scene, number: int, names: Sequence[str]) -> tuple[str, str]:
    """Return the key of a body in the scene, or the key of its data and its row."""
    row, name = number - len(scene.body), names[number]
    if row < 0:
        return body_key(number, name), ""
    for section, columns in zip(scene.bodies, scene.data, strict=True):
        if row < len(columns):
            own = f' ("{name}")' if columns.name else ""
            return f"row {row}{own}", f" of {section.called}"
        row -= len(columns)
    raise IndexError(number)


def refuse_unresolved(
    called: str, key: KeyPath, reach: float, radius: float, units: UnitSystem, remedy: str = ""
) -> None:
    """Refuse bodies smaller than the spacing of floating-point numbers at their positions; lengths in m."""
    step = float(np.spacing(reach))
    if step > radius:
        away, apart, size = (units.text(length, LENGTH, ".3g") for length in (reach, step, radius))
        raise SceneError(
            f"{called}: {away} from the origin, positions are {apart} apart, and the radius is "
            f"{size}; place it nearer to the origin or enlarge the radius{remedy}",
            key,
        )


def refuse_overflow(start: InitialBodies) -> None:
    """Refuse bodies whose mass, moment of inertia or motion overflows or underflows."""
    with np.errstate(over="ignore", divide="ignore"):
        wrong = {
            "mass": ~(np.isfinite(start.mass) & (np.isfinite(1.0 / start.mass) | (start.mass == 0.0))),
            "moment of inertia": ~(
                np.isfinite(start.inertia) & (np.isfinite(1.0 / start.inertia) | (start.mass == 0.0))
            ),
            "velocity": ~np.isfinite(start.velocity).all(axis=1),
            "angular velocity": ~np.isfinite(start.angular_velocity).all(axis=1),
        }
    for what, bodies in wrong.items():
        if bodies.any():
            worst = int(np.argmax(bodies))
            called = body_called(worst, start.name[worst])
            raise SceneError(f"the {what} of {called} is too large or too small a number; choose other units")


def refuse_overlaps(scene: Scene, start: InitialBodies, box: FloatArray | None) -> None:
    """Refuse overlapping bodies, except overlaps that may be due to the rounding of positions to seven digits."""
    pairs = overlapping_pairs(start.position, start.radius, box)
    if len(pairs) == 0:
        return
    i, j = pairs.T
    reach = start.radius[i] + start.radius[j]
    distance = np.sqrt(squared_distance(start.position[i], start.position[j], box))
    rounding = _rounding(start, reach) + np.minimum(_written(start)[i] + _written(start)[j], MOST_WRITTEN * reach)
    overlap = reach - distance
    deep = np.flatnonzero(overlap > rounding)
    if len(deep) == 0:
        return
    worst = int(np.argmax(overlap - rounding))
    others = [k for k in deep[: MOST_PAIRS + 1] if k != worst][:MOST_PAIRS]

    def called(k: int) -> str:
        (first, source), (second, its) = (_place_of(scene, int(number), start.name) for number in pairs[k])
        return f"{first}{'' if source == its else source} and {second}{its}"

    more = ""
    if others:
        left = len(deep) - 1 - len(others)
        more = f"; so do {', '.join(map(called, others))}{f' and {left} more pairs' if left else ''}"
    depth = scene.unit_system.text(overlap[worst], LENGTH)
    raise SceneError(
        f"{called(worst)} overlap by {depth} at the start{more}; move them apart, or set contact.allow_overlap = true",
        key_of(scene, int(pairs[worst, 0])),
    )


def refuse_outside(scene: Scene, start: InitialBodies, solids: HalfSpaces) -> None:
    """Refuse bodies outside of a wall, even if bodies may overlap at the start."""
    first = len(solids) - len(scene.wall)
    heights = solids.heights(start.position)[:, first:]
    if heights.min() < 0.0:
        body, wall = np.unravel_index(np.argmin(heights), heights.shape)
        name = solids.name[first + int(wall)]
        raise SceneError(
            f"{written_name(scene, int(body), start.name)} is outside of {name} at the start, which must have all "
            "bodies inside; move it in, or enlarge or remove the wall",
            key_of(scene, int(body)),
        )


def refuse_immersion(scene: Scene, start: InitialBodies, solids: HalfSpaces) -> None:
    """Refuse bodies that overlap a plane or a wall."""
    depth = solids.depth(start.position, start.radius)
    rounding = (_rounding(start, start.radius) + np.minimum(_written(start), MOST_WRITTEN * start.radius))[:, None]
    if len(solids) and np.max(depth - rounding) > 0.0:
        body, plane = np.unravel_index(np.argmax(depth - rounding), depth.shape)
        deep = scene.unit_system.text(depth[body, plane], LENGTH)
        raise SceneError(
            f"{written_name(scene, int(body), start.name)} overlaps {solids.name[plane]} by {deep} at the start; move "
            "it out, or set contact.allow_overlap = true",
            key_of(scene, int(body)),
        )


def _rounding(start: InitialBodies, length: FloatArray) -> FloatArray:
    """Return bounds of the rounding errors of lengths (m); each is less than the length itself."""
    return np.asarray(np.minimum(1e-9 * length + 4 * np.spacing(np.abs(start.position).max()), 0.5 * length))


def _written(start: InitialBodies) -> FloatArray:
    """Return the rounding error of each centre, (n,) m, if its coordinates have seven digits."""
    return np.asarray(WRITTEN * np.sqrt(np.sum(start.position * start.position, axis=1)))
