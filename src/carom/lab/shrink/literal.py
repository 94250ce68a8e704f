"""The scene to shrink, as a document with all bodies, read from a scene or a recording."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

from carom.arrays import FloatArray
from carom.errors import RecordingError, SceneError
from carom.physics.placement import place
from carom.recording.edit.bundle import is_bundle, opened
from carom.recording.read.recorded_scene import recorded_scene, start_of
from carom.recording.read.recording import Recording
from carom.runs.window import checkpoint_before
from carom.scene.load import Scene
from carom.scene.matter import body_materials
from carom.scene.scene_file import RECORDED
from carom.scene.schema.body import SOLID
from carom.scene.schema.contact import DEFAULT
from carom.scene.start import InitialBodies, half_spaces
from carom.state.frame import Frame

Document = dict[str, Any]  # a scene, as for `Scene.from_dict`
KeyPath = tuple[str | int, ...]  # keys of tables and indices of lists

BODIES = "body"
ORIGIN = [0.0, 0.0, 0.0]  # default of each vector of a body; a vector equal to it is left out
# keys of a scene that are not copied
_NOT_COPIED = {"body", "bodies", "group", "sweep", "promise", "description", "units"}


@dataclass(frozen=True, slots=True)
class BodyStates:
    """The state of all bodies at one step of a run."""

    step: int
    time: float  # s
    dt: float  # s, length of the step that led to this state
    position: FloatArray  # (n, 3) m
    velocity: FloatArray  # (n, 3) m/s
    spin: FloatArray | None  # (n, 3) rad/s

    @classmethod
    def of(cls, frame: Frame) -> BodyStates:
        """Return the state of a frame that owns its arrays."""
        return cls(frame.step, frame.time, frame.dt, frame.position, frame.velocity, frame.angular_velocity)

    @property
    def size(self) -> int:
        """Size in bytes."""
        return self.position.nbytes * (2 if self.spin is None else 3)


def literal(scene: Scene, start: InitialBodies) -> Document:
    """Return a scene with each body written out under its name, in the units of the simulation.

    Raises SceneError if bodies enter during the run.
    """
    if scene.admits:
        raise SceneError(
            "bodies enter during the run ([group.release]), which a scene of single bodies cannot state; use carom fork"
        )
    given = scene.model_dump(mode="python", exclude_defaults=True, exclude_none=True, exclude=_NOT_COPIED)
    document: Document = _plain(given)
    if isinstance(scene.units, str):  # the simulation uses these units
        document["units"] = scene.units
        document["gravity"] = {"constant": scene.gravity.constant} | document.get("gravity", {})
    if names := half_spaces(scene).name[: len(scene.plane)]:
        document["plane"] = [{"name": name} | plane for name, plane in zip(names, document["plane"], strict=True)]
    for name, wall in zip(scene.wall_names, document.get("wall", []), strict=True):
        wall["name"] = name
    materials = body_materials(scene) if scene.material else None
    named = None if materials is None else [materials.names[index] for index in materials.index]
    document[BODIES] = bodies_of(start, named)
    return document


def bodies_of(start: InitialBodies, materials: Sequence[str] | None = None) -> list[Document]:
    """Return a table for each body, with the name of its material if it has a material."""
    bodies = []
    for k, name in enumerate(start.name):
        body: Document = {"name": name, "position": start.position[k].tolist()}
        for key, vector in (("velocity", start.velocity[k]), ("angular_velocity", start.angular_velocity[k])):
            if vector.any():
                body[key] = vector.tolist()
        body |= {"radius": float(start.radius[k]), "mass": float(start.mass[k])}
        material = DEFAULT if materials is None else materials[k]
        # the moment of inertia is written unless the material determines it
        if (factor := _inertia_factor(start, k)) != SOLID or material != DEFAULT:
            body["inertia_factor"] = factor
        if start.fixed[k]:
            body["fixed"] = True
        if material != DEFAULT:
            body["material"] = material
        bodies.append(body)
    return bodies


def at_moment(document: Document, moment: BodyStates, duration: float) -> Document:
    """Return a document that begins with a given state and lasts for ``duration`` seconds."""
    bodies = []
    for k, body in enumerate(document[BODIES]):
        state = {"position": moment.position[k].tolist()}
        if not body.get("fixed"):
            state["velocity"] = moment.velocity[k].tolist()
            if moment.spin is not None:
                state["angular_velocity"] = moment.spin[k].tolist()
        bodies.append({key: value for key, value in (body | state).items() if value != ORIGIN})
    return with_value(document | {BODIES: bodies}, ("time", "duration"), duration)


def with_bodies(document: Document, kept: list[int]) -> Document:
    """Return a document with some of its bodies."""
    return document | {BODIES: [document[BODIES][k] for k in kept]}


def with_value(document: Document, path: KeyPath, value: Any) -> Document:
    """Return a document with another value at a path; None removes the key."""

    def changed(node: Any, path: KeyPath, value: Any) -> Any:
        key: Any = path[0]
        if below := path[1:]:
            value = changed(node[key] if isinstance(node, list) else node.get(key, {}), below, value)
        if isinstance(node, list):
            return [value if k == key else item for k, item in enumerate(node)]
        kept = {name: item for name, item in node.items() if name != key or value is not None}
        return kept if value is None else kept | {key: value}

    return cast(Document, changed(document, path, value))


def value_at(document: Document, path: KeyPath) -> Any:
    """Return the value at a path; None if there is none."""
    node: Any = document
    for key in path:
        try:
            node = node[key]
        except (KeyError, IndexError, TypeError):
            return None
    return node


def _inertia_factor(start: InitialBodies, k: int) -> float:
    """Return I/(m r²), or exactly the factor of a solid sphere if it differs only by rounding."""
    if start.mass[k] == 0.0:
        return SOLID
    factor = float(start.inertia[k]) / (float(start.mass[k]) * float(start.radius[k]) * float(start.radius[k]))
    return SOLID if abs(factor - SOLID) <= 1e-12 * SOLID else min(factor, 2 / 3)


def _plain(value: Any) -> Any:
    """Convert tuples to lists, as in TOML."""
    if isinstance(value, dict):
        return {key: _plain(inner) for key, inner in value.items()}
    return [_plain(inner) for inner in value] if isinstance(value, list | tuple) else value


def source_of(given: str, overrides: list[str]) -> tuple[Scene, InitialBodies]:
    """Read a scene and its bodies; for a recording or a bundle, the bodies come from the first checkpoint.

    Raises SceneError or RecordingError if there is no checkpoint, or the recording cannot be run again.
    """
    path = Path(given)
    recorded = False
    if path.is_file():
        with path.open("rb") as file:
            recorded = file.read(len(RECORDED)) == RECORDED or is_bundle(path)
    if not recorded:
        scene = Scene.load(given, overrides)
        return scene, place(scene)
    with opened(path) as file:
        recording = Recording.open(file)
        if recording.clip.get("bodies"):
            raise RecordingError(f"{path}: a clip of selected bodies cannot be rerun; give the whole recording")
        scene = recorded_scene(recording, overrides)
        checkpoint = checkpoint_before(recording, 0.0)
        start = start_of(recording, scene, checkpoint)
    left = scene.time.duration - checkpoint.time
    if left <= 0.0:
        raise RecordingError(f"{path}: it contains only its last state, so there is nothing to rerun")
    later = scene.time.model_copy(update={"duration": left}) if checkpoint.time > 0.0 else scene.time
    return scene.model_copy(update={"time": later}), start
