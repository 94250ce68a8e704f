"""The pistons of a scene: their planes, and the faces on which their pressures act."""

from __future__ import annotations

from typing import NamedTuple, Protocol

from carom.scene.schema.body import SolidPlane
from carom.scene.schema.piston import Piston
from carom.scene.schema.quantity import SectionError
from carom.scene.schema.settings import Domain

AXES = "xyz"


class Enclosed(Protocol):
    """The planes and the space that enclose the bodies of a scene."""

    @property
    def plane(self) -> tuple[SolidPlane, ...]:
        """The planes."""
        ...

    @property
    def domain(self) -> Domain:
        """The domain."""
        ...


class Side(NamedTuple):
    """A side of the face on which a pressure acts."""

    length: float  # m, length of the side at the start
    pistons: tuple[int, ...]  # numbers of the planes that shorten the side as they move along their normals


def pistons_of(scene: Enclosed) -> dict[int, Piston]:
    """Return the sections of the pistons by the numbers of their planes."""
    return {number: plane.piston for number, plane in enumerate(scene.plane) if plane.piston is not None}


def sides_of_face(scene: Enclosed, number: int) -> tuple[Side, Side]:
    """Return the two sides of the face on which the pressure of a piston acts.

    Along an axis on which pistons move, a side reaches from plane to plane; along other axes, its length is
    `domain.size`. Raises SectionError if this plane or size is missing.
    """
    own = _axis_of(scene, number)
    if own is None:
        key = "plane", number, "piston", "pressure"
        raise SectionError(
            key, "needs a normal along x, y or z, to define the area on which its pressure acts; give the force instead"
        )
    first, second = (_side(scene, number, axis) for axis in range(3) if axis != own)
    return first, second


def _side(scene: Enclosed, number: int, axis: int) -> Side:
    key, size = ("plane", number, "piston", "pressure"), scene.domain.size
    moving = tuple(plane for plane in pistons_of(scene) if _axis_of(scene, plane) == axis)
    if not moving:
        if size is None:
            raise SectionError(
                key, "needs domain.size, to define the area on which its pressure acts; give the force instead"
            )
        return Side(size[axis], ())
    low, high = [], []
    if size is not None and axis in scene.domain.walled:
        low, high = [-0.5 * size[axis]], [0.5 * size[axis]]
    for other, plane in enumerate(scene.plane):
        if _axis_of(scene, other) == axis:
            (low if plane.normal[axis] > 0.0 else high).append(plane.point[axis])
    if not low or not high or min(high) <= max(low):
        called = scene.plane[moving[0]].name or f"plane.{moving[0]}"
        raise SectionError(
            key,
            f"needs a plane opposite to {called}, to define the area on which its pressure acts; add one along "
            f"{AXES[axis]}, or give the force instead",
        )
    return Side(min(high) - max(low), moving)


def _axis_of(scene: Enclosed, number: int) -> int | None:
    """Return the axis of the normal of a plane; None if it is oblique."""
    along = [axis for axis, component in enumerate(scene.plane[number].normal) if component]
    return along[0] if len(along) == 1 else None
