"""The scene to shrink, as a document with all bodies: read from a scene or a recording, and written to a file.

The file is TOML with comments. One of them records whether the reduction is finished.
"""

from __future__ import annotations

import hashlib
import re
import textwrap
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import tomlkit

from carom.arrays import FloatArray
from carom.errors import RecordingError
from carom.physics.frame import Frame
from carom.physics.placement import place
from carom.recording.edit.bundle import is_bundle, opened
from carom.recording.read.recorded_scene import recorded_scene, start_of
from carom.recording.read.recording import Recording
from carom.recording.write.whole_file import write_whole
from carom.runs.environment import versions
from carom.runs.window import checkpoint_before
from carom.scene.load import Scene
from carom.scene.matter import body_materials
from carom.scene.scene_file import RECORDED
from carom.scene.schema.contact import DEFAULT
from carom.scene.start import InitialBodies, half_spaces
from carom.scene.wording import counted

if TYPE_CHECKING:
    from carom.lab.shrink.reducer import Reduction, Stage

Document = dict[str, Any]  # a scene, as for `Scene.from_dict`
KeyPath = tuple[str | int, ...]  # keys of tables and indices of lists

BODIES = "body"
ORIGIN = [0.0, 0.0, 0.0]  # the default of every vector of a body, which is left out
_NOT_COPIED = {"body", "bodies", "group", "sweep", "promise", "description", "units"}  # keys of a scene
_FACTOR = 0.4  # moment of inertia of a solid sphere over m r²
_MARK = re.compile(
    r"^# shrink ([0-9a-f]{12}) of (\d{1,9}) bodies and (\d{1,9}) steps, (unfinished|minimal)$", re.MULTILINE
)
_HEAD = 10_000  # characters at the beginning of a file that are searched for the mark


@dataclass(frozen=True, slots=True)
class BodyStates:
    """The state of all bodies at one step of a run."""

    step: int
    time: float  # s
    dt: float  # s, the step that led here
    position: FloatArray  # (n, 3) m
    velocity: FloatArray  # (n, 3) m/s
    spin: FloatArray | None  # (n, 3) rad/s

    @classmethod
    def of(cls, frame: Frame) -> BodyStates:
        """Return the state of a frame that owns its arrays."""
        return cls(frame.step, frame.time, frame.dt, frame.position, frame.velocity, frame.angular_velocity)

    @property
    def size(self) -> int:
        """Bytes."""
        return self.position.nbytes * (2 if self.spin is None else 3)


def literal(scene: Scene, start: InitialBodies) -> Document:
    """Return a scene with each body written out under its name, in the units of the simulation."""
    given = scene.model_dump(mode="python", exclude_defaults=True, exclude_none=True, exclude=_NOT_COPIED)
    document: Document = _plain(given)
    if isinstance(scene.units, str):  # the scene is simulated in them
        document["units"] = scene.units
        document["gravity"] = {"constant": scene.gravity.constant} | document.get("gravity", {})
    if names := half_spaces(scene).name[: len(scene.plane)]:
        document["plane"] = [{"name": name} | plane for name, plane in zip(names, document["plane"], strict=True)]
    for name, wall in zip(scene.wall_names, document.get("wall", []), strict=True):
        wall["name"] = name
    materials = body_materials(scene) if scene.material else None
    document[BODIES] = []
    for k, name in enumerate(start.name):
        body: Document = {"name": name, "position": start.position[k].tolist()}
        for key, vector in (("velocity", start.velocity[k]), ("angular_velocity", start.angular_velocity[k])):
            if vector.any():
                body[key] = vector.tolist()
        body |= {"radius": float(start.radius[k]), "mass": float(start.mass[k])}
        material = DEFAULT if materials is None else materials.names[materials.index[k]]
        # a moment of inertia may follow from the material
        if (factor := _inertia_factor(start, k)) != _FACTOR or material != DEFAULT:
            body["inertia_factor"] = factor
        if start.fixed[k]:
            body["fixed"] = True
        if material != DEFAULT:
            body["material"] = material
        document[BODIES].append(body)
    return document


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
    """Return I/(m r²) without the rounding of the product."""
    if start.mass[k] == 0.0:
        return _FACTOR
    factor = float(start.inertia[k]) / (float(start.mass[k]) * float(start.radius[k]) * float(start.radius[k]))
    return _FACTOR if abs(factor - _FACTOR) <= 1e-12 * _FACTOR else min(factor, 2 / 3)


def _plain(value: Any) -> Any:
    """Convert tuples to lists, as in TOML."""
    if isinstance(value, dict):
        return {key: _plain(inner) for key, inner in value.items()}
    return [_plain(inner) for inner in value] if isinstance(value, list | tuple) else value


def source_of(given: str, overrides: list[str]) -> tuple[Scene, InitialBodies]:
    """Read a scene and its bodies; of a recording or a bundle, those of the first checkpoint.

    Raises SceneError or RecordingError if there is none, or the recording cannot be run again.
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


def key_of(scene_toml: str, condition: str) -> str:
    """Return a digest (48 bits) of a scene and a condition."""
    return hashlib.sha256(f"{scene_toml}\0{condition}".encode()).hexdigest()[:12]


@dataclass(frozen=True, slots=True)
class Earlier:
    """The result of an earlier reduction."""

    finished: bool
    before: tuple[int, int]  # of the scene before the reduction: bodies, and steps up to the failure


def earlier(path: Path, key: str) -> Earlier | None:
    """Return the earlier result in a file; None if it is the result of another reduction."""
    try:
        with path.open(encoding="utf-8") as file:
            found = _MARK.search(file.read(_HEAD))
    except (OSError, UnicodeDecodeError):
        return None
    if found is None or found[1] != key:
        return None
    return Earlier(found[4] == "minimal", (int(found[2]), int(found[3])))


def unfinished_text(
    document: Document, asked: str, said: str, before: tuple[int, int], key: str, command: str, why: str = ""
) -> str:
    """Return the text of the smallest scene so far, from which the same command continues."""
    comments = [command, f"Asked for: {asked}", f"Shown here: {said}"]
    comments.append(f"Not finished ({why or 'still at work'}): the same command continues from here.")
    return commented(document, [*comments, _mark(key, before, "unfinished")])


def text_of(reduction: Reduction, asked: str, key: str, command: str) -> str:
    """Return the text of a reduced scene with its comments."""
    made, before = reduction.document, reduction.before
    if not reduction.minimal:
        return unfinished_text(made, asked, reduction.said, before, key, command, reduction.stopped)
    bodies, steps = before
    taken = f"{counted(reduction.steps, 'step')} of {steps}"
    if reduction.steps > steps:  # steps may change with fewer bodies
        taken = f"{counted(reduction.steps, 'step')}, instead of {steps} in the original scene"
    left = f"Left: {counted(reduction.bodies, 'body')} of {bodies}, {taken}."
    told: list[Stage] = []  # the first stage of each name, and all that changed the number of bodies or steps
    for stage in reduction.stages:
        known = any(stage.name == other.name for other in told)
        if not known or (stage.bodies, stage.steps) != (told[-1].bodies, told[-1].steps):
            told.append(stage)
    found = "; ".join(f"{one.name}, {counted(one.bodies, 'body')}, {counted(one.steps, 'step')}" for one in told)
    how = f"Found by carom {versions()['carom']} with {reduction.candidates} candidates in {reduction.seconds:.3g} s"
    comments = [
        command,
        f"Asked for: {asked}",
        f"Failure: {reduction.said}",
        f"{left} Without any one body, key or digit, the failure disappears.",
        f"{how}: {found}.",
        _mark(key, before, "minimal"),
    ]
    return commented(made, comments)


def _mark(key: str, before: tuple[int, int], state: str) -> str:
    return f"shrink {key} of {before[0]} bodies and {before[1]} steps, {state}"


def write(path: Path, text: str) -> None:
    """Replace a file atomically, so that an interrupt leaves a whole one. Raises RecordingError if that fails."""
    try:
        write_whole(path, text)
    except OSError as error:
        raise RecordingError(f"cannot write {path}: {error.strerror}") from None


WIDTH = 110  # characters of a comment


def commented(document: Document, comments: list[str]) -> str:
    """Return the text of a scene with comments above it, each a paragraph, and one line for each body."""
    written = tomlkit.document()
    for paragraph in comments:
        for line in textwrap.wrap(paragraph, WIDTH, break_long_words=False, break_on_hyphens=False):
            written.add(tomlkit.comment(line))
    written.add(tomlkit.nl())
    for key in [key for key, value in document.items() if not isinstance(value, dict | list)]:
        written.add(key, document[key])
    for key in [BODIES, *(key for key, value in document.items() if isinstance(value, list) and key != BODIES)]:
        # a line for each table
        rows = tomlkit.array()
        for values in document[key]:
            row = tomlkit.inline_table()
            row.update(values)
            rows.append(row)
        written.add(key, rows.multiline(True))
    for key, value in document.items():
        if isinstance(value, dict):
            table = tomlkit.table()
            for name, inner in value.items():
                table.add(name, inner)
            written.add(key, table)
    return tomlkit.dumps(written)
