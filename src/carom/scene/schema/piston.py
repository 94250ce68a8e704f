"""[plane.piston]: a plane with a mass that moves along its normal, under a constant force."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Self

from pydantic import Field, model_validator

from carom.scene.integrators import AUTO
from carom.scene.schema.quantity import Positive, Real, Section, SectionError
from carom.scene.units.dimension import FORCE, MASS, PRESSURE, VELOCITY

if TYPE_CHECKING:
    from carom.scene.schema.scene import SceneModel


class Piston(Section):
    """[plane.piston]: a mass that moves along the normal of the plane only, under a force and gravity.

    Contacts move it, so it exerts the given force on the bodies whenever it does not accelerate.
    """

    mass: Annotated[Positive, MASS] = Field(description="kg, more than 0")
    force: Annotated[Real, FORCE] | None = Field(None, description="N, along the normal: presses on the bodies if > 0")
    pressure: Annotated[Real, PRESSURE] | None = Field(
        None, description="Pa, instead of a force: on the face of `domain.size` that the normal is perpendicular to"
    )
    velocity: Annotated[Real, VELOCITY] = Field(0.0, description="m/s, along the normal, at the start")

    @model_validator(mode="after")
    def _has_one_load(self) -> Self:
        if self.force is not None and self.pressure is not None:
            raise ValueError("force and pressure are both given; leave one out")
        return self


def piston_of(scene: SceneModel) -> tuple[int, Piston] | None:
    """Return the number of the plane that is a piston, and its section; None if there is none."""
    return next(((k, plane.piston) for k, plane in enumerate(scene.plane) if plane.piston is not None), None)


def force_of(scene: SceneModel) -> float:
    """Return the given force on the piston, along the normal of its plane, in N."""
    numbered = piston_of(scene)
    if numbered is None:
        return 0.0
    number, piston = numbered
    if piston.pressure is None:
        return piston.force or 0.0
    axis = next(axis for axis, along in enumerate(scene.plane[number].normal) if along)
    first, second = (length for k, length in enumerate(scene.domain.size or (0.0, 0.0, 0.0)) if k != axis)
    return piston.pressure * first * second


def refuse_what_has_no_piston(scene: SceneModel) -> None:
    """Refuse a piston with parts of the model that know only planes at rest, or with a prescribed motion."""
    numbered = piston_of(scene)
    if numbered is None:
        return
    number, piston = numbered
    key, time, contact = ("plane", number, "piston"), scene.time, scene.contact
    remedies = {
        "a second piston": ("remove one of them", sum(plane.piston is not None for plane in scene.plane) > 1),
        "contact.enabled = false": ("remove one of them", not contact.enabled),
        f'contact.solver = "{contact.solver}"': ('set "lasting"', contact.solver != "lasting"),
        "contact.sleep": ("remove one of them", contact.sleep is not None),
        "a [drag]": ("remove one of them", scene.drag is not None),
        "time.accuracy": ("remove one of them", time.accuracy is not None),
        f'time.integrator = "{time.integrator}"': ('set "leapfrog"', time.integrator not in (AUTO, "leapfrog")),
        'a group with arrangement = "compressed"': (
            'use another arrangement, such as "random"',
            any(group.arrangement == "compressed" for group in scene.group),
        ),
    }
    for what, (remedy, given) in remedies.items():
        if given:
            raise SectionError(key, f"with {what}, which does not support a piston; {remedy}")
    axes = [axis for axis, along in enumerate(scene.plane[number].normal) if along]
    if piston.pressure is not None and (scene.domain.size is None or len(axes) > 1):
        lacks = "domain.size" if scene.domain.size is None else "a normal along x, y or z"
        raise SectionError((*key, "pressure"), f"needs {lacks}, for the area on which it acts; give the force instead")
