"""`Source`: the model and the states of another engine's run, in SI or other consistent units."""

from __future__ import annotations

import importlib
from collections.abc import Sequence
from dataclasses import dataclass, field
from importlib.metadata import PackageNotFoundError, version
from itertools import pairwise
from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from carom.arrays import BoolArray, FloatArray
from carom.errors import RecordingError
from carom.recording.schema.header import LARGEST
from carom.scene.start import HalfSpaces

MASSLESS = 1e-30  # replaces the mass 0 of a test particle, in units of the largest mass
DRAWN_RADIUS = 0.01  # replaces the radius 0 of a point mass, in units of the bodies' extent
ROUGHLY = 0.01  # largest relative error in the length of a quaternion or normal
SPHERE = 0.4  # moment of inertia / (m r²)
CONTACT = np.dtype(
    [
        ("i", np.int64),  # the first body, or n + k for plane k
        ("j", np.int64),
        ("point", np.float64, 3),  # m
        ("normal", np.float64, 3),  # (3,) unit vector from i to j
        ("force", np.float64),  # N, along the normal on j; the opposite force acts on i
        ("friction", np.float64, 3),  # N, the tangential force on j
    ]
)


class Plane(NamedTuple):
    """A static half-space; bodies are on the side where ``normal · x > offset``."""

    normal: tuple[float, float, float]
    offset: float = 0.0  # m, distance of the plane from the origin along `normal`
    name: str = ""


@dataclass(frozen=True, kw_only=True)
class Model:
    """The constants of a run.

    The audit checks the laws of ``judged`` bodies, by default all bodies. Judged bodies must be free spheres. Other
    bodies are drawn as spheres, and bodies that touch them are not judged.
    """

    engine: str  # name and version, such as ``mujoco 4.0.0``
    mass: Any  # (n,) kg; 0 for a test particle
    radius: Any  # (n,) m; 0 for a point mass, which nothing touches
    inertia: Any = None  # (n,) kg m², moments of inertia; by default those of solid spheres
    names: Sequence[str] | None = None  # (n,) names of the bodies
    fixed: Any = None  # (n,) whether a body never moves; by default none
    judged: Any = None  # (n,) whether the audit checks the laws of a body; by default all
    gravity: Sequence[float] = (0.0, 0.0, 0.0)  # m/s², a uniform field
    constant: float = 0.0  # m³ kg⁻¹ s⁻², constant of the bodies' mutual gravity
    softening: float = 0.0  # m
    planes: Sequence[Plane] = field(default_factory=tuple)  # static half-spaces
    box: Any = None  # (3,) m, the size of a periodic box
    collides: bool = True  # whether bodies touch each other and the planes
    restitution: float | None = None  # coefficient of restitution of all contacts, for the audit; None: unknown
    friction: float | None = None  # Coulomb coefficient of all contacts, for the audit; None: unknown
    time_step: float = 0.0  # s, the shortest step to expect; 0 if unknown
    units: str = ""  # units of all numbers, as in `Recorder`; empty for SI
    # 1/s, rates at which velocities and spins of all bodies decay. If None, they are measured, provided that all free
    # bodies share a rate.
    damping: float | None = None
    angular_damping: float | None = None
    every: int = 1  # default number of calls of `Recorder.frame` per recorded frame; above 1 if states are slow to copy


@dataclass(slots=True)
class State:
    """The state of a run at one moment. Arrays may be views of the engine's own memory: they are copied."""

    time: float  # s
    position: Any  # (n, 3) m
    velocity: Any  # (n, 3) m/s
    orientation: Any = None  # (n, 4) quaternions, xyzw; None if the engine has none
    angular_velocity: Any = None  # (n, 3) rad/s, spins in the world frame; None if the engine has none
    contacts: Any = None  # (m,) `CONTACT` with forces, or (m, 2) touching bodies, n + k for plane k; None: unknown
    # (n,) whole numbers that identify the bodies of this state, if bodies come and go; None: the bodies of the first
    # state
    ids: Any = None
    mass: Any = None  # (n,) kg, with ids: needed in states with new bodies; if it changes, another body begins
    radius: Any = None  # (n,) m, under the same conditions as the mass
    names: Any = None  # (n,) with ids, as in `Model`, or empty; names and flags are read only for new bodies
    fixed: Any = None
    judged: Any = None
    # (n, 3) N, applied forces, drag and compensation of gravity in the step up to this state, without the uniform
    # field, contacts and `Model.damping`; given in all states, including the first, or in none
    force: Any = None
    torque: Any = None  # (n, 3) N m, torques in the world frame


class Source(Protocol):
    """A run of another engine."""

    @property
    def model(self) -> Model:
        """The constants of the run."""

    def state(self) -> State:
        """Return the present state."""


@runtime_checkable
class SteppedSource(Protocol):
    """A source that keeps the time itself, because its engine does not report it."""

    def stepped(self) -> None:
        """Count a call of `Recorder.frame` after the first call, whether or not a frame is recorded."""


@dataclass(frozen=True, slots=True)
class Setup:
    """A model whose arrays are complete and checked."""

    engine: str
    mass: FloatArray  # (n,) kg, positive
    radius: FloatArray  # (n,) m, positive
    inertia: FloatArray  # (n,) kg m², positive
    names: list[str]
    fixed: BoolArray  # (n,)
    judged: BoolArray  # (n,) whether the audit checks the laws of each body
    gravity: FloatArray  # (3,) m/s²
    constant: float
    softening: float
    planes: HalfSpaces
    box: FloatArray  # (3,) m, zeros in open space
    collides: bool
    restitution: float | None
    friction: float | None
    touches: BoolArray  # (n,), False for points
    time_step: float
    damping: float | None  # 1/s; None if unknown
    angular_damping: float | None
    spins: bool
    turns: bool  # whether orientations are known
    forces: bool  # whether contacts have forces

    def __len__(self) -> int:
        return len(self.mass)

    @property
    def field_strength(self) -> float:
        """The size of the uniform field, in m/s²."""
        return float(np.sqrt(self.gravity @ self.gravity))


def has_forces(contacts: Any) -> bool:
    """Return whether contacts are records with forces, and not only pairs."""
    return getattr(getattr(contacts, "dtype", None), "names", None) is not None


def setup_of(model: Model, first: State) -> Setup:
    """Check a model and its first state, and add missing arrays. RecordingError names the wrong array and its body."""
    if not isinstance(model.engine, str) or not model.engine:
        raise RecordingError(f'engine is {model.engine!r}; it must be a name, such as "mine 1.0"')
    engine = text_from(model.engine)
    mass = _column(engine, "mass", model.mass)
    n = len(mass)
    if n == 0:
        raise RecordingError(f"{engine} contains no body: add bodies before you create the recorder")
    radius = _column(engine, "radius", model.radius, n)
    position = array_of(engine, "position", first.position, (n, 3))
    touches = radius > 0.0
    if mass.max() == 0.0:
        raise RecordingError(f"{engine}: all masses are 0, so that no energy or momentum can be computed")
    extent = float(np.ptp(position, axis=0).max()) or float(np.abs(position).max()) or 1.0
    drawn = np.where(radius > 0.0, radius, DRAWN_RADIUS * extent)
    heavy = np.where(mass > 0.0, mass, MASSLESS * mass.max())
    inertia = SPHERE * heavy * drawn**2 if model.inertia is None else _column(engine, "inertia", model.inertia, n)
    inertia = np.where(inertia > 0.0, inertia, SPHERE * heavy * drawn**2)
    names = [f"body {k}" for k in range(n)] if model.names is None else [*map(text_from, model.names)]
    if len(names) != n:
        raise RecordingError(f"{engine}: names has {len(names)} entries for {n} bodies")
    box = np.zeros(3) if model.box is None else array_of(engine, "box", model.box, (3,))
    if model.box is not None and not box.min() > 0.0:
        raise RecordingError(f"{engine}: box is {box.tolist()}; all three sizes must be positive, or it must be None")
    meets = n > 1 or len(model.planes) > 0 or first.ids is not None
    collides = model.collides and bool(touches.any()) and meets
    return Setup(
        engine=engine,
        mass=heavy,
        radius=drawn,
        inertia=np.maximum(inertia, np.finfo(np.float64).tiny),
        names=names,
        fixed=flags_of(engine, "fixed", model.fixed, n, False),
        judged=flags_of(engine, "judged", model.judged, n, True),
        gravity=array_of(engine, "gravity", model.gravity, (3,)),
        constant=_not_negative(engine, "constant", model.constant),
        softening=_not_negative(engine, "softening", model.softening),
        planes=_planes(engine, model.planes),
        box=box,
        collides=collides,
        restitution=None if model.restitution is None else _not_negative(engine, "restitution", model.restitution),
        friction=None if model.friction is None else _not_negative(engine, "friction", model.friction),
        touches=touches,
        time_step=_not_negative(engine, "time_step", model.time_step),
        damping=None if model.damping is None else _not_negative(engine, "damping", model.damping),
        angular_damping=None
        if model.angular_damping is None
        else _not_negative(engine, "angular_damping", model.angular_damping),
        spins=first.angular_velocity is not None,
        turns=first.orientation is not None,
        forces=collides and has_forces(first.contacts),
    )


def array_of(engine: str, name: str, values: Any, shape: tuple[int, ...]) -> FloatArray:
    """Return a finite float64 array of a given shape. RecordingError names the first wrong number."""
    array = _numbers(engine, name, values)
    if array.shape != shape:
        raise RecordingError(f"{engine}: {name} has the shape {array.shape} instead of {shape}")
    if not np.isfinite(array).all():
        row = np.argwhere(~np.isfinite(array))[0]
        place = ", ".join(map(str, row))
        raise RecordingError(f"{engine}: {name}[{place}] is {array[tuple(row)]}, which is not finite")
    return array


def time_of(state: State) -> float:
    """Return the time (s) of a state. RecordingError quotes a value that is not a number."""
    try:
        return float(state.time)
    except (TypeError, ValueError, OverflowError):
        raise RecordingError(f"the time of the state is {state.time!r}; it must be a number") from None


def refuse_invalid_state(setup: Setup, first: State) -> None:
    """Refuse arrays of wrong shapes, and quaternions whose length is not 1, up to rounding in single precision."""
    engine, n = setup.engine, len(setup)
    array_of(engine, "time", time_of(first), ())
    array_of(engine, "velocity", first.velocity, (n, 3))
    for name, width in (("orientation", 4), ("angular_velocity", 3), ("force", 3), ("torque", 3)):
        if getattr(first, name) is not None:
            array_of(engine, name, getattr(first, name), (n, width))
    if first.orientation is not None:
        length = np.linalg.norm(np.asarray(first.orientation, dtype=np.float64), axis=1)
        wrong = np.flatnonzero(np.abs(length - 1.0) > ROUGHLY)
        if len(wrong):
            wrong_one = f"orientation[{wrong[0]}] has the length {length[wrong[0]]:g}"
            raise RecordingError(f"{engine}: {wrong_one}; it must be a quaternion of length 1, xyzw")


def text_from(value: Any) -> str:
    """Return a program's value as a text that a file can hold: lone surrogates, which UTF-8 lacks, become escapes."""
    return str(value).encode("utf-8", "backslashreplace").decode("utf-8")


def _numbers(engine: str, name: str, values: Any) -> FloatArray:
    """Return an array of float64; RecordingError if the values are not numbers."""
    try:
        if unfit := _unfit(values):
            raise TypeError(f"it has {unfit}")
        return np.array(values, dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise RecordingError(f"{engine}: {name} is not an array of numbers: {error}") from None


def _unfit(values: Any) -> str:
    """Name contents of an array that NumPy would silently convert to numbers; empty if there are none."""
    kind = getattr(getattr(values, "dtype", None), "kind", "f")
    if kind == "c":  # the imaginary parts would be dropped
        return "complex numbers"
    if kind not in "fiubO":
        return f"values of the type {values.dtype}"
    # otherwise masked values would be taken for numbers
    return "masked values" if isinstance(values, np.ma.MaskedArray) and np.ma.is_masked(values) else ""


def _column(engine: str, name: str, values: Any, n: int | None = None) -> FloatArray:
    """Return non-negative numbers, one for each body."""
    array = np.atleast_1d(_numbers(engine, name, values))
    array = array_of(engine, name, array, (len(array) if n is None else n,))
    if len(array) and array.min() < 0.0:
        raise RecordingError(f"{engine}: {name}[{int(array.argmin())}] is {array.min():g}; it cannot be negative")
    return array


def flags_of(engine: str, name: str, values: Any, n: int, default: bool) -> BoolArray:
    """Return a flag for each body; ``default`` if there are no values."""
    if values is None:
        return np.full(n, default)
    given = np.array(values, dtype=object)
    if given.shape != (n,):
        raise RecordingError(f"{engine}: {name} has the shape {given.shape} instead of ({n},)")
    for body, value in enumerate(given.tolist()):
        if isinstance(value, (str, bytes)) or value not in (False, True):
            raise RecordingError(f"{engine}: {name}[{body}] is {value!r}; it must be True or False")
    return given.astype(np.bool_)


def _not_negative(engine: str, name: str, value: float) -> float:
    number = _numbers(engine, name, value)
    if number.shape or not 0.0 <= number < np.inf:
        shown = value if number.shape else f"{float(number):g}"
        raise RecordingError(f"{engine}: {name} is {shown}; it must be a number that is not negative")
    return float(number)


def _planes(engine: str, planes: Sequence[Plane]) -> HalfSpaces:
    try:
        planes = [Plane(*plane) for plane in planes]
    except TypeError:
        raise RecordingError(f"{engine}: planes must be a list of carom.record.Plane") from None
    count = len(planes)
    normals = [plane.normal for plane in planes] if count else np.empty((0, 3))
    normal = array_of(engine, "the normals of the planes", normals, (count, 3))
    length = np.linalg.norm(normal, axis=1)
    if not np.all(length > 0.0):
        raise RecordingError(f"{engine}: the normal of a plane has length 0")
    return HalfSpaces(
        name=[text_from(plane.name or f"plane {k}") for k, plane in enumerate(planes)],
        normal=normal / length[:, None],
        offset=array_of(engine, "the offsets of the planes", [plane.offset for plane in planes], (count,)),
    )


_LEAST, _MOST = np.minimum.reduce, np.maximum.reduce  # the methods `min` and `max` would call Python code
_WIDTHS = {"position": 3, "velocity": 3, "orientation": 4, "angular_velocity": 3, "force": 3, "torque": 3}


_Floats = NDArray[np.floating[Any]]


class StateMemory:
    """Memory for one state.

    The engine's thread fills the memory with few calls: one copy per array, and two passes over all numbers to check
    that they are finite. All numbers are in one block: the arrays of the state, and the parts that a `BulkSource`
    fills, are views of the block.
    """

    def __init__(self, state: State, block: _Floats, parts: tuple[NDArray[Any], ...] = ()) -> None:
        self.state, self.block, self.parts = state, block, parts
        block.fill(0.0)  # otherwise the system would allocate the memory during the first copy

    @classmethod
    def like(cls, state: State) -> StateMemory:
        """Return memory in float64 for states with the same arrays as a given state."""
        there = [name for name in _WIDTHS if getattr(state, name) is not None]
        shapes = [np.shape(getattr(state, name)) for name in there]
        ends = np.cumsum([0, *(int(np.prod(shape)) for shape in shapes)])
        block = np.empty(int(ends[-1]))
        parts = [block[a:b].reshape(shape) for (a, b), shape in zip(pairwise(ends), shapes, strict=True)]
        return cls(State(state.time, **dict(zip(there, parts, strict=True))), block)

    def take(self, state: State) -> None:
        """Copy a state. Raises RecordingError if the state's arrays have other shapes, or its time is not a number."""
        own = self.state
        own.time = time_of(state)
        if state.ids is not None:  # the arrays belong to the bodies of this state
            for name in ("ids", "mass", "radius", "names", "fixed", "judged"):
                values = getattr(state, name)
                setattr(own, name, None if values is None else np.array(values))
            count = np.shape(state.position)[:1]
            if count and count != own.position.shape[:1]:  # fit the memory to the number of bodies
                there = [name for name in _WIDTHS if getattr(own, name) is not None]
                other = StateMemory.like(State(own.time, **{name: np.empty((*count, _WIDTHS[name])) for name in there}))
                self.block = other.block
                for name in there:
                    setattr(own, name, getattr(other.state, name))
        for name in _WIDTHS:
            view = getattr(own, name)
            if view is not None:
                values = getattr(state, name)
                if np.shape(values) != view.shape:  # otherwise NumPy would broadcast the rows
                    changed = f"{name} has the shape {np.shape(values)}, but had {view.shape}"
                    raise RecordingError(f"{changed}; where bodies come and go, give each state their ids")
                if unfit := _unfit(values):
                    raise RecordingError(f"{name} has {unfit}")
                view[:] = values
        own.contacts = None if state.contacts is None else np.array(state.contacts)

    @property
    def bounded(self) -> bool:
        """Whether all numbers are finite and below the overflow bound."""
        if not -LARGEST <= self.state.time <= LARGEST:
            return False
        if self.block.size == 0:
            return True
        # the comparison also fails if a number is NaN; Python floats are compared, since `LARGEST` exceeds float32
        return float(_LEAST(self.block, None)) >= -LARGEST and float(_MOST(self.block, None)) <= LARGEST


@runtime_checkable
class BulkSource(Protocol):
    """A source that copies the engine's memory directly into a snapshot, without temporary arrays."""

    def memory(self) -> StateMemory:
        """Return memory that `read` can fill."""

    def read(self, into: StateMemory) -> None:
        """Copy the present state."""


def engine_package(name: str, distribution: str | None = None) -> Any:
    """Import an engine's package. Raises RecordingError, with the line that installs it, if it is missing."""
    try:
        return importlib.import_module(name)
    except ImportError:
        raise RecordingError(f"the engine {name} is not installed: pip install {distribution or name}") from None


def named_version(name: str, distribution: str | None = None) -> str:
    """Return the name and the version of an engine."""
    try:
        return f"{name} {version(distribution or name)}"
    except PackageNotFoundError:
        return name
