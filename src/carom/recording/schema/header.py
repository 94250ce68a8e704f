"""The header of a recording, written before the first frame, and the recording properties with their valid values."""

from __future__ import annotations

import hashlib
import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from carom.arrays import BoolArray, ColourArray, FloatArray, IntArray
from carom.errors import DamageError
from carom.recording.schema import palette
from carom.recording.schema.paths import MOVING, SCHEMA_VERSION
from carom.scene.data.body_columns import BodyColumns
from carom.scene.extensions import PROPERTY
from carom.scene.forces import FORCES
from carom.scene.matter import KindOfContact, body_materials, kinds_of_contacts, material_called
from carom.scene.portable_math import ENDLESS
from carom.scene.schema import Scene
from carom.scene.schema.motion import WallMotion
from carom.scene.schema.shear import Shear
from carom.scene.schema.wall import Wall
from carom.scene.start import HalfSpaces
from carom.scene.units.dimension import OF_UNIT
from carom.scene.units.system import SI, UnitSystem


@dataclass(frozen=True)
class ShownMaterials:
    """Materials of a scene with [[material]]."""

    names: list[str]  # (a,) names of the materials that bodies have
    colours: list[int]  # (a,) 0xRRGGBBAA
    index: IntArray  # (n,) index of each body's material
    has_colours: bool  # whether the scene gives a material a colour
    contacts: list[KindOfContact]

    @classmethod
    def of(cls, scene: Scene) -> ShownMaterials | None:
        """Return the materials of a scene; None if it has no [[material]]."""
        if not scene.material:
            return None
        found = body_materials(scene)
        known = [material_called(scene, name) for name in found.names]
        given = [material.colour if material else None for material in known]
        contacts = kinds_of_contacts(scene)
        return cls(found.names, palette.material_colours(given), found.index, any(given), contacts)

    def body_colours(self) -> ColourArray:
        """Return the colour of each body, (n,)."""
        return np.array(self.colours, dtype=np.uint32)[self.index]

    @property
    def described(self) -> list[dict[str, Any]]:
        """Return each material with the number of its bodies and its kinds of contacts, for `carom inspect --json`."""
        count = np.bincount(self.index, minlength=len(self.names)).tolist()
        return [
            {
                "name": name,
                "bodies": bodies,
                "colour": palette.name_of(colour),
                "contacts": {
                    kind.other(name): kind.coefficients._asdict() for kind in self.contacts if name in kind.between
                },
            }
            for name, bodies, colour in zip(self.names, count, self.colours, strict=True)
        ]


Scalar = str | int | float | bool

STATIC_COLOURS = ("group", "material")  # colourings that are constant during a run
COLOUR_BY = (*STATIC_COLOURS, "speed", "graph", "island")

_FLAGS = {
    "accuracy": "promises",
    "contact": "collides",
    "friction": "has_friction",
    "record.impacts": "records_contacts",  # not a part of the model, but required by series of contacts
    "wall.motion": "drives",  # not a part of the model, but required by the work of moving walls
    "driving-field": "has_driving_field",  # not a part of the model, but required by its work along periodic axes
    "shear": "shears",  # not a part of the model, but required by the work of a sheared box
    "spin": "spins",
    "stabilisation": "stabilises",
}
_FORCES = {kind.recorded_with: kind for kind in FORCES}
_PLOTS_IN_UNITS = 3  # first version of the rules of drawing with plots in the units of a scene with [units]
_MOVING_WALLS = 4  # first version in which planes and walls are drawn where they move
RECORDED_PARTS = (*_FLAGS, *_FORCES)  # parts of the model on which series depend


def flag_of(part: str) -> str:
    """Return the name of the property that states whether the scene requires a part of the model."""
    if part in _FLAGS:
        return _FLAGS[part]
    return _FORCES[part].present if part in _FORCES else f"{PROPERTY}forces.{part}"


@dataclass(frozen=True, slots=True)
class SweepMember:
    """The place of a run in its sweep."""

    name: str  # shown instead of the title
    parameters: Mapping[str, Any]  # the varied keys and the random seed, as in TOML
    command: str  # the command that started the sweep


@dataclass(frozen=True, slots=True)
class Header:
    """Everything static about a run: its bodies, and which parts of the model the scene requires.

    A recording has no entities for parts whose flag is false.
    """

    title: str
    description: str  # Markdown, for people
    scene_toml: str  # the exact text
    seed: int
    run_id: str  # a UUID; the recording id
    names: Sequence[str]  # (n,)
    group: IntArray  # (n,); bodies of one group share a hue
    mass: FloatArray  # (n,) kg
    radius: FloatArray  # (n,) m
    inertia: FloatArray  # (n,) kg m²
    spins: bool  # whether bodies have angular velocities and rotational energy
    has_orientation: bool
    has_torque: bool  # whether they also have angular accelerations
    has_friction: bool
    forces: frozenset[str]  # named as in `scene.forces` or by extensions
    collides: bool
    stabilises: bool  # whether position correction removes overlaps, which adds energy
    body_colouring: bool  # contact.colouring = "bodies": bodies have colours in the collision graph
    duration: float  # s of simulated time, as requested
    shortest_dt_hint: float  # s, the finest step to expect; 0 if unknown
    check_interval: float | None = None  # s, between checks of energy and momentum; None if they are at the frames
    promises: bool = False  # whether it promises an accuracy
    drives: bool = False  # whether a wall moves
    motions: Mapping[str, WallMotion] = field(default_factory=dict)  # of walls that move, by their entities
    has_driving_field: bool = False  # whether a uniform field has a component along a periodic axis
    shear: Shear | None = None  # of a periodic domain
    record_impacts: Literal["auto", "all", "none"] = "none"  # applies to the contact table, too
    box: FloatArray | None = None  # (3,) m, size of a periodic domain, `ENDLESS` along axes that do not repeat
    units: UnitSystem = SI  # units of the recorded and of the printed numbers
    walls: FloatArray | None = None  # (3,) m, size of a walled domain
    planes: HalfSpaces | None = None  # the static half-spaces other than the walls
    shapes: Sequence[Wall] | None = None  # walls of other shapes; empty if only their drawing is known
    colour_by: str = "auto"  # record.colour_by
    data: tuple[BodyColumns, ...] = ()  # the bodies of each [[bodies]] table of the scene
    data_notes: Sequence[Sequence[str]] = ()  # for each [[bodies]] table: unused columns of its file
    materials: ShownMaterials | None = None  # None in a scene without [[material]]
    properties: Mapping[str, Scalar] = field(default_factory=dict)  # versions, command, git, cpu …
    member: SweepMember | None = None  # None for a single run
    engine: str = ""  # name and version of the engine that computed the run; empty for carom
    uniform_field: FloatArray | None = (
        None  # (3,) m/s², uniform field of another engine; None for carom, and if unknown
    )
    exact: bool = False  # whether every frame has a checkpoint
    fixed: BoolArray | None = None  # (n,) bodies of another engine that never move; for carom, the scene names them
    drawn_as: str = ""  # the shape of drawn bodies, where it does not follow from their number
    extensions: Mapping[str, str] = field(default_factory=dict)  # versions by name, see `extensions_of`
    drawing_rules: int = 4  # version of the rules of drawing (docs/recording.md); 1 in the first recordings

    def models(self, part: str) -> bool:
        """Return whether the scene requires a part of the model, by its name in `carom explain`."""
        if part in _FLAGS:
            return bool(getattr(self, _FLAGS[part]))
        return (_FORCES[part].name if part in _FORCES else part) in self.forces

    def plot_unit(self, si: str) -> str:
        """Name the unit in which plots show a quantity, given its SI unit; "1" for none."""
        if self.drawing_rules < _PLOTS_IN_UNITS or si not in OF_UNIT:
            return self.units.recorded_unit(si)
        return self.units.unit(OF_UNIT[si]) or "1"

    def plot_factor(self, si: str) -> float:
        """Return the size of a plot's unit in recorded numbers, given the SI unit of a quantity."""
        if self.drawing_rules < _PLOTS_IN_UNITS or si not in OF_UNIT:
            return 1.0
        return self.units.factor(OF_UNIT[si])

    @property
    def draws_motion(self) -> bool:
        """Whether planes and walls are drawn each, where they move."""
        return self.drives and self.drawing_rules >= _MOVING_WALLS

    @property
    def coloured_by(self) -> str:
        """The quantity that colours the bodies: "group" or "material" (both static), "speed", "graph" or "island"."""
        if self.colour_by != "auto":
            return self.colour_by
        if self.body_colouring:
            return "graph"
        return "material" if self.materials and self.materials.has_colours else "group"

    def static_colours(self, by: str) -> NDArray[np.uint32]:
        """Return the colours of all bodies by group or by material, (n,)."""
        if by == "material" and self.materials:
            return self.materials.body_colours()
        return palette.body_colours(self.group)

    @property
    def shears(self) -> bool:
        """Whether the periodic domain is sheared."""
        return self.shear is not None

    def cell(self, time: float) -> FloatArray | None:
        """Return the size of the periodic box, (3,) m, or the vectors to its images if it is sheared, (3, 3) m."""
        return self.box if self.box is None or self.shear is None else self.shear.cell(self.box, time)

    @property
    def records_contacts(self) -> bool:
        """Whether impacts and the contact table are recorded."""
        return self.collides and self.record_impacts != "none"

    @property
    def drawn_box(self) -> FloatArray | None:
        """Size of the periodic box as drawn, (3,) m; along an axis that does not repeat, that of the walls, or 0."""
        if self.box is None:
            return None
        return np.where(self.box < ENDLESS, self.box, 0.0 if self.walls is None else self.walls)

    @property
    def bodies(self) -> int:
        """Number of bodies."""
        return len(self.mass)


def motions_of(scene: Scene) -> dict[str, WallMotion]:
    """Return the motions of planes and walls by their entities."""
    planes = {f"{MOVING}/plane-{k}": plane.motion for k, plane in enumerate(scene.plane)}
    walls = {f"{MOVING}/wall-{k}": wall.motion for k, wall in enumerate(scene.wall)}
    return {path: motion for path, motion in (planes | walls).items() if motion is not None and motion.moves}


def scene_digest(text: str) -> str:
    """Return the SHA-256 of a scene's text, in hexadecimal digits; a recording states it beside the text."""
    return hashlib.sha256(text.encode()).hexdigest()


_PATTERN = re.compile(r"carom-([0-9]{1,9})-[0-9a-f]+")


def application_id(header: Header) -> str:
    """``carom-<schema>-<layout>``.

    A viewer keeps one layout, with its camera, per application id. The id therefore includes a hash of the scene.
    Rerun replaces slashes, so the id contains none.
    """
    layout = hashlib.sha256(f"{header.scene_toml}\n{header.bodies} {header.spins}".encode()).hexdigest()
    return f"carom-{SCHEMA_VERSION}-{layout[:12]}"


def schema_version(identity: str) -> int | None:
    """Read the schema version from an application id; None if carom did not make the recording."""
    match = _PATTERN.fullmatch(identity)
    return None if match is None else int(match.group(1))


MOST_BODIES = 10_000_000
LARGEST = 1e150  # largest coordinate or speed, so that squares do not overflow

NOTES = re.compile(r"data_notes\.[0-9]{1,9}")  # keys of notes on data files, one for each [[bodies]] table
_NUMBERS = re.compile(r"([0-9]{1,9}(,[0-9]{1,9})*)?")


def _text(value: Any) -> bool:
    return isinstance(value, str)


def _flag(value: Any) -> bool:
    return isinstance(value, bool)


def _whole(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool)


def _number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _positive(value: Any) -> bool:
    return _number(value) and 0.0 < value < math.inf


def _count(value: Any) -> bool:
    return _whole(value) and 1 <= value <= MOST_BODIES


def _vector(value: Any) -> bool:
    return isinstance(value, list) and len(value) == 3 and all(_number(part) and math.isfinite(part) for part in value)


def _bodies(value: Any) -> bool:
    return all(_whole(body) and 0 <= body < MOST_BODIES for body in (value if isinstance(value, list) else [value]))


def _numbers(value: Any) -> bool:
    return isinstance(value, str) and _NUMBERS.fullmatch(value) is not None


_WHAT: dict[Callable[[Any], bool], str] = {
    _text: "a text",
    _flag: "true or false",
    _whole: "a whole number",
    _number: "a number",
    _positive: "a positive number",
    _count: f"a number from 1 to {MOST_BODIES}",
    _vector: "three finite numbers",
    _bodies: "numbers of bodies",
    _numbers: "numbers of bodies with commas between them",
}

_KEYS: dict[str, dict[str, Callable[[Any], bool]]] = {
    "carom": {
        "title": _text,
        **dict.fromkeys(("units", "units.*"), _text),
        **dict.fromkeys(("colour_by", "drawn_as", "engine"), _text),
        "plane_names": _text,
        "data_notes.*": _text,
        "bodies": _count,
        **dict.fromkeys(("time_scale", "check_interval"), _positive),
        "origin": _vector,
        **dict.fromkeys(("box", "uniform_field"), _vector),
        "schema_version": _whole,
        "drawing_rules": _whole,
        "seed": _whole,
        "duration": _number,
        "arrow_length.*": _number,
        **dict.fromkeys(("spins", "has_*", "gravitates", "collides", "stabilises", "promises", "drives"), _flag),
        **dict.fromkeys(("body_colouring", "records_contacts", "states_at_impacts"), _flag),
    },
    "run": {"version.*": _text, "command": _text, "git": _text, "platform": _text, "cpu": _text},
    "arrows": {"*": _number},
    "clip": {"source": _text, "recording_id": _text, "from": _number, "to": _number, "bodies": _bodies},
    "outcome": {
        "outcome": _text,
        **dict.fromkeys(("frames", "steps", "contacts.total", "contacts.impacts", "moments.*.step"), _whole),
        **dict.fromkeys(("impacts.*", "audit.judged"), _whole),
        **dict.fromkeys(
            ("sim_time", "wall_time", "energy.*", "momentum.*", "angular_momentum.*", "accuracy.*"), _number
        ),
        **dict.fromkeys(("contacts.max_overlap", "moments.*.value", "moments.*.time", "profile.*"), _number),
        **dict.fromkeys(("moments.*.bodies", "moments.*.planes"), _numbers),
        "moments.*.between": _text,
        "expect.*.bound": _text,
        **dict.fromkeys(("laws.*.step", "laws.*.frames"), _whole),
        "laws.*.time": _number,
        "laws.*.text": _text,
        **dict.fromkeys(("expect.*.limit", "expect.*.measured"), _number),
        **dict.fromkeys(("expect.*.met", "expect.*.judged"), _flag),
    },
}
_REQUIRED = {"carom": ("bodies", "time_scale"), "clip": ("source", "from", "to"), "outcome": ("outcome",)}


def checked(name: str, values: Mapping[str, Any]) -> dict[str, Any]:
    """Return a property after checking the values of all known keys; an empty property was never written.

    Raises
    ------
    DamageError
        The message names the key and the valid values, if a value is wrong.
    """
    for key in _REQUIRED.get(name, ()) if values else ():
        if key not in values:
            raise DamageError(f"its property {name} has no {key}")
    for key, value in values.items():
        for pattern, is_right in _KEYS.get(name, {}).items():
            if fnmatchcase(key, pattern) and not is_right(value):
                raise DamageError(f"its property {name} has {key} = {str(value)[:40]!r} instead of {_WHAT[is_right]}")
    return dict(values)
