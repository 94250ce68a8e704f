"""The header of a recording, written before the first frame, the recording properties, and the scale of time."""

from __future__ import annotations

import hashlib
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from carom.arrays import BoolArray, ColourArray, FloatArray, IntArray
from carom.errors import RecorderError
from carom.recording.schema import palette
from carom.recording.schema.paths import MOVING, SCHEMA_VERSION
from carom.scene.data.body_columns import BodyColumns
from carom.scene.extensions import PROPERTY
from carom.scene.forces import FORCES
from carom.scene.load import Scene
from carom.scene.matter import KindOfContact, body_materials, kinds_of_contacts, material_called
from carom.scene.portable_math import ENDLESS
from carom.scene.schema.motion import WallMotion
from carom.scene.schema.shear import Shear
from carom.scene.schema.wall import Wall
from carom.scene.start import EntryStates, HalfSpaces
from carom.scene.units.dimension import OF_UNIT, TIME
from carom.scene.units.system import SI, UnitSystem


@dataclass(frozen=True)
class ShownMaterials:
    """Materials of a scene with [[material]]."""

    names: list[str]  # (a,) names of the bodies' materials
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
        """Describe each material for `carom inspect --json`: the number of its bodies, and its kinds of contacts."""
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

STATIC_COLOURS = ("group", "material")  # colourings that do not change during a run
COLOUR_BY = (*STATIC_COLOURS, "speed", "graph", "island")

_FLAGS = {
    "accuracy": "promises",
    "contact": "collides",
    "friction": "has_friction",
    "record.impacts": "records_contacts",  # no part of the model; series of contacts depend on it
    "wall.motion": "drives",  # not a part of the model, but the series of the work of moving walls depends on it
    "piston": "has_piston",  # not a part of the model, but the series of the piston's motion depend on it
    "release": "admits",  # not a part of the model, but the series of the energy of entering bodies depends on it
    # not a part of the model, but the series of the field's work along periodic axes depends on it
    "driving-field": "has_driving_field",
    "shear": "shears",  # not a part of the model, but the series of the work of a sheared box depends on it
    "spin": "spins",
    "stabilisation": "stabilises",
}
_FORCES = {kind.recorded_with: kind for kind in FORCES}
RECORDED_PARTS = (*_FLAGS, *_FORCES)  # parts of the model on which series depend


def flag_of(part: str) -> str:
    """Return the name of the property that states whether the scene requires a part of the model."""
    if part in _FLAGS:
        return _FLAGS[part]
    return _FORCES[part].present if part in _FORCES else f"{PROPERTY}forces.{part}"


@dataclass(frozen=True, slots=True)
class SweepMember:
    """The place of a run in its sweep."""

    name: str  # name shown instead of the title
    parameters: Mapping[str, Any]  # values of the varied keys and the random seed, as in TOML
    command: str  # the command that started the sweep


@dataclass(frozen=True, slots=True)
class Header:
    """The static data of a run: its bodies, and the parts of the model that the scene requires.

    If the flag of a part is false, the recording has no entities for this part.
    """

    title: str
    description: str  # Markdown, for people
    scene_toml: str  # the exact text
    seed: int
    run_id: str  # a UUID, which is also the id of the recording
    names: Sequence[str]  # (n,)
    group: IntArray  # (n,) group of each body; bodies of one group share a hue
    mass: FloatArray  # (n,) kg
    radius: FloatArray  # (n,) m
    inertia: FloatArray  # (n,) kg m²
    spins: bool  # whether bodies have angular velocities and rotational energy
    has_orientation: bool
    has_torque: bool  # whether bodies also have angular accelerations
    has_friction: bool
    forces: frozenset[str]  # names of forces, as in `scene.forces` or in extensions
    collides: bool
    stabilises: bool  # whether position correction removes overlaps, which adds energy
    body_colouring: bool  # contact.colouring = "bodies": bodies have colours in the collision graph
    duration: float  # s, requested simulated time
    shortest_dt_hint: float  # s, shortest step to expect; 0 if unknown
    check_interval: float | None = None  # s between checks of energy and momentum; None if only frames are checked
    promises: bool = False  # whether the run promises an accuracy
    drives: bool = False  # whether a wall moves
    motions: Mapping[str, WallMotion] = field(default_factory=dict)  # motions of moving walls, by entity
    pistons: Sequence[int] = ()  # numbers of the planes that contacts move
    entries: EntryStates | None = None  # how bodies enter; None if all exist from the start
    outlets: Sequence[str] = ()  # names of the places where bodies leave
    has_driving_field: bool = False  # whether a uniform field has a component along a periodic axis
    shear: Shear | None = None  # shear of a periodic domain
    record_impacts: Literal["auto", "all", "none"] = "none"  # which impacts and contact tables are recorded
    box: FloatArray | None = None  # (3,) m, size of a periodic domain, `ENDLESS` along axes that do not repeat
    units: UnitSystem = SI  # units of the recorded and of the printed numbers
    walls: FloatArray | None = None  # (3,) m, size of a walled domain
    planes: HalfSpaces | None = None  # the static half-spaces other than the walls
    shapes: Sequence[Wall] | None = None  # walls of other shapes; empty if only their drawing is known
    colour_by: str = "auto"  # record.colour_by
    data: tuple[BodyColumns, ...] = ()  # the bodies of each [[bodies]] table in the scene
    data_notes: Sequence[Sequence[str]] = ()  # notes on unused columns in the file of each [[bodies]] table
    materials: ShownMaterials | None = None  # None in a scene without [[material]]
    properties: Mapping[str, Scalar] = field(default_factory=dict)  # versions, command, git, cpu …
    member: SweepMember | None = None  # None for a single run
    engine: str = ""  # name and version of the engine that computed the run; empty for carom
    # (3,) m/s², field of another engine; None for carom, or for an unknown engine
    uniform_field: FloatArray | None = None
    gravity_constant: float = 0.0  # m³ kg⁻¹ s⁻², constant of another engine's own gravity; 0 for carom
    gravity_softening: float = 0.0  # m
    exact: bool = False  # whether every frame has a checkpoint
    fixed: BoolArray | None = None  # (n,) bodies of another engine that never move; for carom, the scene names them
    judged: BoolArray | None = None  # (n,) bodies of another engine whose laws are known; None means all bodies
    drawn_as: str = ""  # shape of drawn bodies; if empty, their number determines it
    extensions: Mapping[str, str] = field(default_factory=dict)  # versions of extensions by name; see `extensions_of`

    def models(self, part: str) -> bool:
        """Return whether the scene requires a part of the model, by its name in `carom explain`."""
        if part in _FLAGS:
            return bool(getattr(self, _FLAGS[part]))
        return (_FORCES[part].name if part in _FORCES else part) in self.forces

    def plot_unit(self, si: str) -> str:
        """Name the unit in which plots show a quantity, given its SI unit; "1" for none."""
        if si not in OF_UNIT:
            return self.units.recorded_unit(si)
        return self.units.unit(OF_UNIT[si]) or "1"

    def plot_factor(self, si: str) -> float:
        """Return the size of a plot's unit in the recorded unit, given the SI unit of the quantity."""
        return self.units.factor(OF_UNIT[si]) if si in OF_UNIT else 1.0

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
    def has_piston(self) -> bool:
        """Whether contacts move planes."""
        return bool(self.pistons)

    @property
    def admits(self) -> bool:
        """Whether bodies enter during the run."""
        return self.entries is not None

    @property
    def shears(self) -> bool:
        """Whether the periodic domain is sheared."""
        return self.shear is not None

    def cell(self, time: float) -> FloatArray | None:
        """Return the size of the periodic box, (3,) m, or, if it is sheared, the vectors to its images, (3, 3) m."""
        return self.box if self.box is None or self.shear is None else self.shear.cell(self.box, time)

    @property
    def records_contacts(self) -> bool:
        """Whether impacts and the contact table are recorded."""
        return self.collides and self.record_impacts != "none"

    @property
    def drawn_box(self) -> FloatArray | None:
        """Size of the periodic box as drawn, (3,) m; along axes that do not repeat, the size of the walls or 0."""
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
    """Return ``carom-<schema>-<layout>``, without slashes, since Rerun replaces them.

    A viewer keeps one layout, with its camera, per application id. The id therefore includes a hash of the scene.
    """
    layout = hashlib.sha256(f"{header.scene_toml}\n{header.bodies} {header.spins}".encode()).hexdigest()
    return f"carom-{SCHEMA_VERSION}-{layout[:12]}"


def schema_version(identity: str) -> int | None:
    """Read the schema version from an application id; None if carom did not make the recording."""
    match = _PATTERN.fullmatch(identity)
    return None if match is None else int(match.group(1))


LARGEST = 1e150  # largest coordinate or speed, so that squares do not overflow

NOTES = re.compile(r"data_notes\.[0-9]{1,9}")  # keys of notes on data files, one for each [[bodies]] table

_LONGEST = 9.0e9  # s; 2⁶³ ns are 9.22e9 s, or 292 years
_PAST_THE_END = 1.02  # up to this factor times `_LONGEST`, a time still fits into 2⁶³ ns
_SMALLEST_POWER = -300  # smallest power of ten of a scale; 1e-308 is the smallest normal number
# s, shortest step that needs no finer scale; with shorter steps, times of impact would have fewer than three digits
_COARSEST = 1.0e-6
_FINE = 1.0e-3  # s, shortest step after scaling, so that times within a step have six digits


@dataclass(frozen=True, slots=True)
class TimeScale:
    """Converts simulated seconds to times on the timeline.

    ``scale`` is a power of ten: one second on the timeline stands for ``scale`` seconds of simulated time.
    """

    scale: float = 1.0

    @classmethod
    def fitting(cls, duration: float, shortest_dt: float) -> TimeScale:
        """Choose the scale: 1 if possible, above 1 for long scenes, below 1 for very short steps.

        If a scene is long and has very short steps, the scale fits the duration, and short steps are rounded.
        """
        least = math.ceil(math.log10(duration / _LONGEST)) if 0.0 < duration < math.inf else _SMALLEST_POWER
        if least > 0:
            return cls(10.0**least)
        if 0.0 < shortest_dt < _COARSEST:
            wanted = math.floor(math.log10(shortest_dt / _FINE))
            return cls(10.0 ** min(0, max(wanted, least)))
        return cls()

    def nanoseconds(self, times: Sequence[float] | FloatArray) -> IntArray:
        """Convert simulated seconds to whole nanoseconds of the timeline, by rounding."""
        shown = np.asarray(times, dtype=np.float64) / self.scale
        if not bool(np.all(np.abs(shown) <= _LONGEST * _PAST_THE_END)):
            raise RecorderError(f"simulated time {np.max(np.abs(times)):g} does not fit the timeline")
        return np.round(shown * 1e9).astype(np.int64)

    def within(self, times: FloatArray, ends: FloatArray | None) -> IntArray:
        """Convert times (s) to nanoseconds before the end of their frame, at ``ends`` (s); see `Index`."""
        shown = self.nanoseconds(times)
        return shown if ends is None or not len(ends) else np.minimum(shown, self.nanoseconds(ends) - 1)


_VIEWER_UNITS = (("d", 86400.0), ("h", 3600.0), ("min", 60.0), ("s", 1.0))


def viewer_time(units: UnitSystem, clock: TimeScale) -> str:
    """Relate the viewer's times, in s, min, h and d, to the times of a scene; empty if the times are the same."""
    if units.is_si and clock.scale == 1.0:
        return ""
    if units.own or units.is_si:
        text = units.text(clock.scale, TIME, ".6g")
        return f"+1s is {text if units.unit(TIME) else f'{text} unit of time'}"
    name, length = units.unit(TIME), units.factor(TIME) / clock.scale  # length of the unit in seconds of the viewer
    if name == "s" and clock.scale == 1.0:
        return ""
    unit, size = next((each for each in _VIEWER_UNITS if each[1] <= length), _VIEWER_UNITS[-1])
    return f"1 {name} is +{length / size:.6g}{unit}"
