"""Refusals of releases and outlets that cannot work."""

from __future__ import annotations

import math

import numpy as np

from carom.arrays import FloatArray
from carom.errors import SceneError
from carom.physics.contact.release.outlets import find_leaving, outlets_of
from carom.physics.placement.region import bounds, half_extent, volume
from carom.scene.load import Scene
from carom.scene.matter import mean_volume
from carom.scene.schema import BodyGroup, Region
from carom.scene.start import HalfSpaces, InitialBodies
from carom.scene.units.dimension import RATE, TIME
from carom.scene.wall_shapes import unit_vector
from carom.scene.wording import body_called

PARALLEL = 1e-12  # difference of the normals of parallel planes
DENSEST = 0.64  # packing fraction of a random close packing; no inlet can be fuller


def refuse_impossible_passages(scene: Scene, start: InitialBodies, solids: HalfSpaces) -> None:
    """Refuse releases and outlets that cannot work.

    Raises
    ------
    SceneError
        The message names the key and the remedy.
    """
    for index, group in enumerate(scene.group):
        if group.release is not None:
            _refuse_late_release(scene, index, group)
            _refuse_too_high_rate(scene, index, group)
    _refuse_unreachable_outlets(scene, solids)
    _refuse_entries_in_outlets(scene, start)


def _refuse_late_release(scene: Scene, index: int, group: BodyGroup) -> None:
    release, end = group.release, scene.time.duration
    assert release is not None, "the group has a release"
    if release.at >= end:
        at, duration = (scene.unit_system.text(time, TIME, "g") for time in (release.at, end))
        raise SceneError(
            f"group.{index}.release.at = {at}: the run ends at {duration}, before a body enters; lower it, or raise "
            "time.duration",
            ("group", index, "release", "at"),
        )


def _refuse_too_high_rate(scene: Scene, index: int, group: BodyGroup) -> None:
    """Refuse a rate that even a densely packed region could not sustain, given its velocity and the field."""
    release, region = group.release, group.region
    if release is None or release.rate is None or region is None or group.count == 1:
        return
    at_once, empties_in = max(1.0, DENSEST * volume(region) / mean_volume(group)), _emptying(scene, group, region)
    key = ("group", index, "release", "rate")
    if math.isinf(empties_in):
        raise SceneError(
            f"group.{index}.release.rate: its bodies enter at rest, and no field moves them out of their region; give "
            "the group a velocity, or set gravity.uniform",
            key,
        )
    if release.rate > at_once / empties_in:
        rate, most = (scene.unit_system.text(each, RATE, ".3g") for each in (release.rate, at_once / empties_in))
        raise SceneError(
            f"group.{index}.release.rate = {rate}: its region empties too slowly for more than {most}; lower the rate, "
            "enlarge the region, or raise the velocity",
            key,
        )


def _emptying(scene: Scene, group: BodyGroup, region: Region) -> float:
    """Return the time (s) in which a body crosses its region, from rest in the field or with its velocity."""
    field, mean = np.array(scene.gravity.uniform), np.array(group.velocity.mean)
    moves = mean if mean.any() else field
    size = math.sqrt(float((moves * moves).sum()))
    random = group.velocity.dispersion
    if size == 0.0:
        return 2.0 * float(half_extent(region).max()) / random if random else math.inf
    along = moves / size
    length = 2.0 * float((np.abs(along) * half_extent(region)).sum())
    speed, pull = float((mean * along).sum()) + random, max(0.0, float((field * along).sum()))
    return 2.0 * length / (speed + math.sqrt(speed * speed + 2.0 * pull * length))


def _refuse_unreachable_outlets(scene: Scene, solids: HalfSpaces) -> None:
    for index, outlet in enumerate(scene.outlet):
        name = scene.outlet_names[index]
        if outlet.region is not None:
            heights = solids.heights(_corners(outlet.region))
        else:
            parallel = (np.abs(solids.normal - unit_vector(outlet.normal)) < PARALLEL).all(axis=1)
            is_flat = np.arange(len(solids)) < len(solids) - len(scene.wall)
            heights = np.where(parallel & is_flat, solids.heights(np.array([outlet.point])), 0.0)
        behind = np.flatnonzero((heights < 0.0).all(axis=0))
        if len(behind):
            raise SceneError(
                f"outlet.{index}: {name} lies behind {solids.name[behind[0]]}, where no body can be; move one of them",
                ("outlet", index),
            )


def _corners(region: Region) -> FloatArray:
    """Return the corners and the centre of the box around a region, (9, 3) m."""
    low, high = bounds(region)
    corners = [[low[0], high[0]], [low[1], high[1]], [low[2], high[2]]]
    return np.concatenate([np.stack(np.meshgrid(*corners), axis=-1).reshape(-1, 3), [region.centre]])


def _refuse_entries_in_outlets(scene: Scene, start: InitialBodies) -> None:
    if not scene.outlet:
        return
    through = np.empty(len(start.mass), dtype=np.int64)
    if find_leaving(start.position, start.fixed, outlets_of(scene), through):
        body = int(np.flatnonzero(through >= 0)[0])
        index = int(through[body])
        raise SceneError(
            f"outlet.{index}: {body_called(body, start.name[body])} enters in {scene.outlet_names[index]}, and would "
            "leave at once; move one of them",
            ("outlet", index),
        )
