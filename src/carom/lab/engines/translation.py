"""What a scene asks of an engine that knows spheres, planes, a uniform field and Coulomb friction."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from carom.errors import ExperimentError
from carom.physics.placement import place
from carom.plan.features import require
from carom.plan.pulls import further
from carom.recording.source.source import SPHERE, Model
from carom.scene.matter import pair_coefficients
from carom.scene.schema import Coefficients, Scene
from carom.scene.start import HalfSpaces, InitialBodies, half_spaces

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Problem:
    """A scene in the terms of a game or robot engine."""

    start: InitialBodies
    planes: HalfSpaces
    between: Coefficients  # of two bodies
    at_planes: list[Coefficients]
    field: FloatArray  # (3,) m/s²
    collides: bool
    duration: float  # s

    @property
    def extent(self) -> float:
        """The distance in m from the middle of the bodies at the start to the farthest, or a radius if that is more."""
        centre = self.start.position.mean(axis=0)
        away = np.linalg.norm(self.start.position - centre, axis=1)
        return float(max(away.max(), self.start.radius.max()))

    @property
    def reach(self) -> float:
        """How far in m a plane must go on, for bodies that keep the largest speed for the whole run."""
        speed = float(np.linalg.norm(self.start.velocity, axis=1).max())
        fall = 0.5 * float(np.linalg.norm(self.field)) * self.duration**2
        return 10.0 * (self.extent + speed * self.duration + fall)

    def named(self, model: Model) -> Model:
        """Return the model of an engine without names, with those of the scene's bodies and planes."""
        named = zip(model.planes, self.planes.name, strict=True)
        return replace(model, names=self.start.name, planes=[plane._replace(name=name) for plane, name in named])


def problem_of(engine: str, scene: Scene) -> Problem:
    """Translate a scene for an engine of rigid bodies.

    Raises
    ------
    ExperimentError
        If the scene has what such engines lack; the message names all of it.
    """
    parts, coefficients, force = require(scene), pair_coefficients(scene), further(scene)
    lacks = {
        "the bodies' own gravity": parts.gravity.modelled,
        "a periodic box": scene.domain.boundary == "periodic",
        "drag": scene.drag is not None,
        f"the force {force}": force != "",
        "bodies of several materials": len(coefficients.places) > 0,
    }
    refuse(engine, lacks)
    start, solids = place(scene), half_spaces(scene)
    solid_spheres = np.allclose(start.inertia, SPHERE * start.mass * start.radius**2, rtol=1e-12)
    refuse(engine, {"test particles (mass = 0)": not start.mass.all()})
    refuse(engine, {"moments of inertia other than those of solid spheres": not solid_spheres})
    laws = [Coefficients(*row.tolist()) for row in coefficients.rows]
    return Problem(
        start=start,
        planes=solids,
        between=laws[0],
        at_planes=laws[1:],
        field=np.array(scene.gravity.uniform, dtype=np.float64),
        collides=parts.contact.modelled,
        duration=scene.time.duration,
    )


def refuse(engine: str, lacks: dict[str, bool]) -> None:
    """Raise ExperimentError if a scene has anything that an engine lacks."""
    found = [what for what, there in lacks.items() if there]
    if found:
        raise ExperimentError(f"{engine} cannot represent this scene: {', '.join(found)}")
