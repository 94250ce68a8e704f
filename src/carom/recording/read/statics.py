"""The static data of a recording: bodies, names, properties, scene and units; and how bodies are stored.

Numbered names are stored as a prefix and numbers. Masses, radii, moments of inertia and names of the bodies of
[[bodies]] tables are stored once, in the arrays of all bodies.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, wraps
from inspect import signature
from typing import Any, Concatenate, ParamSpec, Self, TypeVar

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from carom.arrays import FloatArray, IntArray
from carom.errors import DamageError, RecordingError
from carom.recording.read.entities import Entities, reading
from carom.recording.rrd.container import Container
from carom.recording.rrd.messages import Chunk, Entry, Store
from carom.recording.schema import paths
from carom.recording.schema.header import LARGEST
from carom.recording.timelines import STEP
from carom.scene.data.body_columns import BodyColumns
from carom.scene.data.mapping import VECTORS
from carom.scene.schema.settings import called
from carom.scene.units.system import UnitSystem
from carom.scene.wording import JoinedNames, NumberedNames, SomeNames, joined, one_word


@dataclass(frozen=True, slots=True)
class BodyTable:
    """The static properties of the bodies; a call with a time returns their exact state."""

    name: Sequence[str]  # (n,)
    group: IntArray  # (n,)
    mass: FloatArray  # (n,) kg
    radius: FloatArray  # (n,) m
    inertia: FloatArray  # (n,) kg m²
    _states: Callable[[float | None], pa.Table] = field(repr=False, compare=False)

    def among(self, shown: Sequence[int], bodies: int) -> Self:
        """Return a table of all bodies of a run, in which only the bodies with the numbers ``shown`` are known."""
        values: dict[str, Any] = {name: np.full(bodies, np.nan) for name in ("mass", "radius", "inertia")}
        values["group"] = np.full(bodies, -1)
        for name, spread in values.items():
            spread[shown] = getattr(self, name)
        return replace(self, name=SomeNames("body", bodies, dict(zip(shown, self.name, strict=True))), **values)

    def __call__(self, at: float | None = None) -> pa.Table:
        """Return the state of all bodies at the end of the step that contains a time, in float64.

        The default of the time (s) is `Recording.moment`. Raises RecordingError if the time is not in the recording, or
        the step has no checkpoint; `carom.rerun` then computes the state.

        Returns
        -------
        states
            Columns body, name, x, y, z (m), vx, vy, vz (m/s), with orientations qx, qy, qz, qw, with spins wx, wy, wz
            (rad/s), ax, ay, az (m/s², of forces without contacts and drag), kinetic_energy and, with spins,
            rotational_energy (J). A rerun of a scene with friction adds torque_x … (N m) and angular_acceleration_x …
            (rad/s²). Fields have their unit as metadata. The metadata of the schema state the ``step``, the ``time``
            (s) and the ``source``.
        """
        return self._states(at)


UNFINISHED = "unfinished: the run was killed before it could close the file; `carom repair` completes it"

_Parameters = ParamSpec("_Parameters")
_Result = TypeVar("_Result")
_Own = TypeVar("_Own", bound="Statics")


def named(
    read: Callable[Concatenate[_Own, _Parameters], _Result],
) -> Callable[Concatenate[_Own, _Parameters], _Result]:
    """Let the errors of a method name the file."""
    arguments = signature(read)

    @wraps(read)
    def reads(self: _Own, /, *args: _Parameters.args, **kwargs: _Parameters.kwargs) -> _Result:
        arguments.bind(self, *args, **kwargs)  # a TypeError here is a mistake of the caller, not damage to the file
        with reading(self.path):
            return read(self, *args, **kwargs)

    return reads


class Statics:
    """The properties of a recording, its scene and its units."""

    def __init__(self, container: Container, store: Store) -> None:
        self.path = container.path
        self.finished = container.finished  # whether the file has its footer, so that the run has closed it
        self.store = store
        self._entities = Entities(container, store)

    def chunks(self, entries: Iterable[Entry]) -> Iterator[Chunk]:
        """Read chunks one by one, unchanged."""
        return self._entities.read(entries)

    def row(self, path: str, step: int) -> tuple[Chunk, int] | None:
        """Return the chunk with the last row of an entity at a step, and the row's place in it; None without one."""
        for chunk in self.chunks(self.store.frames_of(path, step, step)):
            rows = np.flatnonzero(chunk.batch[STEP].to_numpy() == step)
            if len(rows):
                return chunk, int(rows[-1])
        return None

    @cached_property
    @named
    def info(self) -> Mapping[str, Any]:
        """The property `carom`: schema version, title, bodies, flags, origin, time scale."""
        return self._entities.properties("carom")

    @cached_property
    @named
    def properties(self) -> Mapping[str, Any]:
        """The property `run`: versions, command, git, cpu and the caller's additions."""
        return self._entities.properties("run")

    @cached_property
    @named
    def parameters(self) -> Mapping[str, Any]:
        """The property `sweep`: the run's name in its sweep, and its varied values; empty for a single run."""
        return self._entities.properties("sweep")

    @cached_property
    @named
    def closing(self) -> Mapping[str, Any]:
        """The property `outcome`: how the run ended; empty if it was killed."""
        return self._entities.properties("outcome")

    @cached_property
    @named
    def arrow_references(self) -> Mapping[str, Any]:
        """The property `arrows`: reference magnitudes of the arrows."""
        return self._entities.properties("arrows")

    @property
    def versions(self) -> dict[str, str]:
        """Versions of the packages that made the file, as names and numbers; other texts of the file are quoted."""
        stamped = ((key.partition("version."), value) for key, value in self.properties.items())
        found = {package: value for (before, dot, package), value in stamped if dot and not before}
        return {one_word(package): one_word(str(value)) for package, value in found.items()}

    @cached_property
    @named
    def clip(self) -> Mapping[str, Any]:
        """The property `clip`: the interval that was cut out; empty for a whole run."""
        return self._entities.properties("clip")

    @cached_property
    @named
    def shown(self) -> Sequence[int]:
        """Numbers of the bodies that the recording shows: all bodies, except in a clip of selected bodies."""
        if "bodies" not in self.clip:
            return range(int(self.info["bodies"]))
        found = [int(body) for body in np.atleast_1d(self.clip["bodies"])]
        if not all(0 <= body < int(self.info["bodies"]) for body in found):
            raise DamageError("it shows bodies that do not exist")
        return found

    @property
    @named
    def shows_all(self) -> bool:
        """Whether the recording shows all bodies of its run; a clip may show only selected bodies."""
        return len(self.shown) == int(self.info["bodies"])

    @property
    @named
    def is_partial(self) -> bool:
        """Whether the recording is a clip without exact states, which contains no data of other bodies."""
        return bool(self.clip.get("partial", False))

    @property
    @named
    def is_overlay(self) -> bool:
        """Whether the recording shows several runs: `carom diff -o` or `carom tradeoff` made it."""
        return bool(self.overlaid)

    @property
    @named
    def overlaid(self) -> Mapping[str, Any]:
        """The metadata of the runs in an overlay, such as the names of their files; empty for a single run."""
        return self._entities.properties("diff") or self._entities.properties("tradeoff")

    def refuse_overlay(self) -> None:
        """Raise RecordingError if the recording shows several runs: an overlay has only drawn positions."""
        if self.is_overlay:
            raise RecordingError(f"{self.path} contains several runs and can only be viewed, with `carom view`")

    def refuse_some_bodies(self) -> None:
        """Raise RecordingError if the recording is a clip of selected bodies."""
        if not self.shows_all:
            raise RecordingError(f"{self.path} is a clip of selected bodies; use the whole recording")

    @property
    @named
    def engine(self) -> str:
        """Name and version of the engine that computed the run; empty for carom."""
        return str(self.info.get("engine", ""))

    @property
    @named
    def uniform_field(self) -> FloatArray | None:
        """Uniform field (3,) m/s² of another engine; None for carom, and in recordings that do not state the field."""
        field = self.info.get("uniform_field")
        return None if field is None else np.array(field, dtype=np.float64)

    @property
    @named
    def check_interval(self) -> float | None:
        """Time (s) between checks of energy and momentum; None if errors are checked at the frames."""
        interval = self.info.get("check_interval")
        return None if interval is None else float(interval)

    @property
    @named
    def records_contacts(self) -> bool:
        """Whether impacts and the contact table are recorded."""
        return bool(self.info.get("records_contacts", False))  # overlays lack this property

    @property
    @named
    def title(self) -> str:
        """The scene's title; an empty title may be stored as an empty text, or not at all."""
        return called(str(self.info.get("title", "")))

    @named
    def data_notes(self, index: int) -> list[str]:
        """Return the notes on the data file of one [[bodies]] table: unused and reinterpreted columns."""
        return str(self.info.get(f"data_notes.{index}", "")).splitlines()

    @property
    @named
    def outcome(self) -> str:
        """How the run ended."""
        return str(self.closing.get("outcome", UNFINISHED))

    @cached_property
    @named
    def units(self) -> UnitSystem:
        """The units of the scene. Recorded numbers are in SI or in the system of units of the scene."""
        return UnitSystem.of_properties(self.info)

    @cached_property
    @named
    def scene_toml(self) -> str:
        """The scene, exactly as it was written."""
        self.refuse_overlay()
        return str(self._entities.static(paths.SCENE_TOML)["TextDocument:text"][0])

    @cached_property
    @named
    def origin(self) -> FloatArray:
        """Origin of the drawn positions in the scene, (3,) m."""
        return np.asarray(self.info["origin"], dtype=np.float64)


Stored = Mapping[str, NDArray[Any] | list[str]]

_COUNT, _FIRST = "name_count", "name_first"


def encode_names(names: Sequence[str]) -> dict[str, Any]:
    """Return the components that hold the names: only ``name`` if no names are numbered.

    Otherwise ``name`` has prefixes, ``name_count`` has the number of bodies with each prefix (0 for a complete name),
    and ``name_first`` has the number in the name of the first such body.
    """
    parts = names.parts if isinstance(names, JoinedNames) else (names,)
    if not any(isinstance(part, NumberedNames) for part in parts):
        return {"name": list(names)}
    texts, counts, firsts = list[str](), list[int](), list[int]()
    for part in parts:
        if isinstance(part, NumberedNames):
            texts.append(part.prefix)
            counts.append(len(part))
            firsts.append(part.first)
        else:
            texts += part
            counts += [0] * len(part)
            firsts += [0] * len(part)
    return {"name": texts, _COUNT: np.array(counts, np.int64), _FIRST: np.array(firsts, np.int64)}


def decode_names(stored: Stored) -> Sequence[str]:
    """Undo `encode_names`. Raises DamageError if the components contradict each other."""
    texts = stored["name"]
    if not isinstance(texts, list):
        raise DamageError("names of its bodies are not text")
    if _COUNT not in stored:
        return texts
    counts, firsts = np.asarray(stored[_COUNT]), np.asarray(stored.get(_FIRST))
    whole = (len(texts),)
    if any(array.shape != whole or array.dtype != np.int64 or np.any(array < 0) for array in (counts, firsts)):
        raise DamageError("the names of its bodies do not have one number each")
    parts, own = list[Sequence[str]](), list[str]()
    for text, count, first in zip(texts, counts.tolist(), firsts.tolist(), strict=True):
        if count == 0:
            own.append(text)
            continue
        parts += [own] if own else []
        parts.append(NumberedNames(text, count, first))
        own = []
    return joined([*parts, *([own] if own else [])])


def encode_bodies(data: Sequence[BodyColumns]) -> dict[str, Any]:
    """Return the components; components that are zero for all bodies are left out."""
    vectors = {name: np.concatenate([getattr(columns, name) for columns in data]).ravel() for name in VECTORS}
    kept = {name: values for name, values in vectors.items() if name == "position" or values.any()}
    fixed = np.concatenate([columns.fixed for columns in data])
    named = np.array([columns.name is not None for columns in data])
    return {**kept, **({"fixed": fixed} if fixed.any() else {}), "named": named}


def decode_bodies(stored: Stored, index: int, row: int, place: range, bodies: BodyTable) -> BodyColumns:
    """Undo `encode_bodies` for one [[bodies]] table, given its index in the scene and the numbers of its bodies.

    ``row`` is the row of the table's first body in the components; ``bodies`` has all bodies of the recording. Raises
    DamageError if the components lack these bodies, or are not finite.
    """
    n, own, has_names = len(place), slice(row, row + len(place)), np.asarray(stored["named"])
    whole = np.asarray(stored["position"]).size // 3
    if place.stop > len(bodies.mass) or row + n > whole or has_names.dtype != np.bool_ or index >= has_names.size:
        raise DamageError("its scene has more bodies than it")
    fixed = np.asarray(stored.get("fixed", np.zeros(whole, np.bool_)))
    if fixed.shape != (whole,) or fixed.dtype != np.bool_:
        raise DamageError("it does not state of each body whether the body is fixed")
    numbers, vectors = slice(place.start, place.stop), dict[str, FloatArray]()
    for name in VECTORS:
        values = np.asarray(stored.get(name, np.zeros(3 * whole)))
        if values.shape != (3 * whole,) or values.dtype != np.float64 or not np.all(np.abs(values) <= LARGEST):
            raise DamageError(f"{name} of the bodies of its scene is not {whole} finite vectors")
        vectors[name] = values.reshape(whole, 3)[own]
    return BodyColumns(
        **vectors,
        mass=bodies.mass[numbers],
        radius=bodies.radius[numbers],
        inertia=bodies.inertia[numbers],
        fixed=fixed[own],
        name=list(bodies.name[numbers]) if has_names[index] else None,
    )
