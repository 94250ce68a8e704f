"""`BodyColumns`: the bodies of one [[bodies]] table as arrays, read from a data table and checked."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from carom.arrays import BoolArray, FloatArray
from carom.errors import SceneError
from carom.scene.data import Arrays, DataTable, Raw, flags_of, numbers_of, step_at, texts_of
from carom.scene.data.facts import Facts, FileColumn, column_factor, refuse_other_units
from carom.scene.data.mapping import (
    DIMENSIONS,
    VECTORS,
    ColumnMapping,
    columns_in,
    mapping_of,
    question,
    unused_columns,
    with_material,
)
from carom.scene.data.orbital_elements import Centre, OrbitTable
from carom.scene.data.steps import Steps, axis_of_steps, rows_of_step, steps_in
from carom.scene.schema.body import BodyData, Missing
from carom.scene.schema.contact import Material
from carom.scene.schema.quantity import LARGEST, SMALLEST
from carom.scene.units.dimension import TIME
from carom.scene.units.system import UnitSystem
from carom.scene.wording import counted


@dataclass(frozen=True, eq=False)
class BodyColumns:
    """Bodies at time 0, in the order of the file; SI units. The arrays must not be changed."""

    position: FloatArray  # (n, 3) m
    velocity: FloatArray  # (n, 3) m/s
    angular_velocity: FloatArray  # (n, 3) rad/s
    mass: FloatArray  # (n,) kg
    radius: FloatArray  # (n,) m
    inertia: FloatArray  # (n,) kg m²
    fixed: BoolArray  # (n,)
    name: list[str] | None = None  # (n,) names; None if bodies are numbered

    def __len__(self) -> int:
        return len(self.mass)

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, BodyColumns):
            return NotImplemented
        return self.name == other.name and all(
            np.array_equal(getattr(self, field.name), getattr(other, field.name))
            for field in fields(self)
            if field.name != "name"
        )

    __hash__ = None  # type: ignore[assignment]

    @cached_property
    def radii(self) -> tuple[float, float]:
        """The smallest and the largest radius in m."""
        return float(self.radius.min()), float(self.radius.max())

    @cached_property
    def heaviest(self) -> int:
        """Number of the heaviest body."""
        return int(np.argmax(self.mass))

    @cached_property
    def massless(self) -> int:
        """Number of bodies of mass 0."""
        return int(np.count_nonzero(self.mass == 0.0))

    @cached_property
    def total_mass(self) -> float:
        """The total mass in kg."""
        return math.fsum(self.mass.tolist())

    @cached_property
    def spins(self) -> bool:
        """Whether a body has an angular velocity."""
        return bool(np.any(self.angular_velocity))

    @cached_property
    def anchors(self) -> bool:
        """Whether a body is fixed."""
        return bool(np.any(self.fixed))

    @cached_property
    def common_velocity(self) -> tuple[float, ...] | None:
        """The velocity (m/s) if all bodies have the same velocity; otherwise None."""
        first = self.velocity[0]
        return tuple(first.tolist()) if np.all(self.velocity == first) else None

    @cached_property
    def sha256(self) -> str:
        """A digest of the arrays, for bodies without a file."""
        digest = hashlib.sha256()
        for field in fields(self):
            values = getattr(self, field.name)
            data = "\0".join(values or ()).encode() if field.name == "name" else np.ascontiguousarray(values).data
            digest.update(f"{field.name} {len(self)}\n".encode())
            digest.update(data)
        return digest.hexdigest()


_POSITIVE = ("density", "radius", "diameter")
_NOT_NEGATIVE = ("mass", "inertia")  # quantities that may be 0, as for a test particle
_SIZES = ("radius", "diameter", "density")  # quantities for which 0 is a missing value
_SAME_DISTANCE = 0.02  # relative difference of distances from the Sun and from the barycentre


class ReadBodies(NamedTuple):
    """The bodies of a table, and the statements of its file; box and time are in units of the simulation."""

    columns: BodyColumns
    notes: tuple[str, ...]
    facts: Facts


def read_columns(
    section: BodyData,
    table: DataTable,
    units: UnitSystem,
    material: Material | None = None,
    centre: Centre | None = None,
) -> ReadBodies:
    """Read and check the bodies of a [[bodies]] table, in units of the simulation.

    ``centre`` is the central body of orbital elements. The notes name used and unused columns. Raises SceneError, which
    names the table, the column and the row.
    """
    orbits = None
    if section.orbit is not None and centre is not None:
        table = orbits = OrbitTable(table, section.orbit, centre, units)
        own = {"position": orbits.position, "velocity": orbits.velocity}
        section = section.model_copy(update={"columns": section.columns.model_copy(update=own)})
    columns_there = columns_in(table, section)
    if material is not None:
        section = with_material(section, material, columns_there)
    mapping = mapping_of(section, columns_there, table)
    if table.law is not None:
        refuse_other_units(table.called, table.facts, units, (d for each in mapping for d in DIMENSIONS.get(each, ())))
    steps = steps_in(columns_there)
    if orbits is not None:  # orbits are computed from the masses
        del mapping["position"], mapping["velocity"]
    wanted = dict.fromkeys([*(column.name for columns in mapping.values() for column in columns), *steps.names])
    raw = table.read(list(wanted), texts=[column.name for column in mapping.get("name", ())])
    reader = _Reader(section, table, mapping, raw, units, steps, None if orbits is None else orbits.rows)
    if orbits is None:
        position, velocity = reader.vectors("position"), reader.vectors("velocity")
        if section.columns.radius is None:
            reader.refuse_distance(position)
    radius = 0.5 * reader.numbers("diameter") if "diameter" in mapping else reader.numbers("radius")
    has_density = "density" in mapping or section.density is not None
    volume = (4.0 / 3.0) * math.pi * radius * radius * radius
    with np.errstate(over="ignore"):
        mass = reader.numbers("density") * volume if has_density else reader.numbers("mass")
        inertia = section.inertia_ratio * mass * radius * radius if "inertia" not in mapping else None
    if orbits is not None:
        position, velocity = orbits.states(mass, reader.kept)
    if (n := len(position)) == 0:
        raise SceneError(f"{table.called}: it has no rows")
    if section.count is not None and section.count != n:
        raise SceneError(f"{table.called}: it has {n} rows, but count = {section.count}")
    columns = BodyColumns(
        position=position if section.origin is None else position - np.array(section.origin),
        velocity=velocity,
        angular_velocity=reader.vectors("angular_velocity"),
        mass=mass,
        radius=radius,
        inertia=reader.numbers("inertia") if inertia is None else inertia,
        fixed=reader.flags(),
        name=reader.names(),
    )
    moves = columns.velocity.any(axis=1) | columns.angular_velocity.any(axis=1)
    mistakes = {
        "is fixed and has a velocity or an angular_velocity; set one of them to 0": columns.fixed & moves,
        "has a mass of 0 and a moment of inertia; set both to 0, or neither": (mass == 0.0) & (columns.inertia > 0.0),
        "has a mass, but no moment of inertia; give it one above 0": (mass > 0.0) & (columns.inertia == 0.0),
    }
    for mistake, rows in mistakes.items():
        if rows.any():
            raise SceneError(f"{table.called}: row {reader.row(int(np.argmax(rows)))} {mistake}")
    unused = unused_columns(section, mapping, columns_there, [*reader.choosing, *(orbits.own if orbits else ())])
    notes = [f"{table.called}: {'; '.join(reader.used)}"] if mapping else []
    if unused:
        notes.append(f"{table.called}: columns that are not used: {unused}")
    facts = table.facts if orbits is None else orbits.stated()
    if facts.time is not None:
        factor = column_factor(table.called, FileColumn("time", "time"), facts, "time", (TIME,), units)
        facts = replace(facts, time=factor * facts.time)
    if facts.box is not None and "position" in mapping:
        facts = replace(facts, box=facts.box.scaled(reader.factor("position")))
    return ReadBodies(columns, (*table.notes, *notes, *reader.notes, *(orbits.advice if orbits else ())), facts)


class _Reader:
    """Converts the columns of each quantity; values that the scene states replace columns."""

    def __init__(
        self,
        section: BodyData,
        table: DataTable,
        mapping: ColumnMapping,
        raw: dict[str, Raw],
        units: UnitSystem,
        steps: Steps,
        rows: int | None,
    ) -> None:
        self._units, self._section, self._mapping = units, section, mapping
        self._called, self._facts = table.called, table.facts
        self._ranges = dict[str, tuple[float, float]]()  # ranges of quantities, in units of the simulation
        own = {
            column.name: 2 if quantity in VECTORS and len(columns) == 1 else 1
            for quantity, columns in mapping.items()
            for column in columns
        }
        axis = axis_of_steps(section, table, steps, raw, own)
        self._raw = {
            column.name: self._step(quantity, column.name, raw[column.name], own[column.name], axis)
            for quantity, columns in mapping.items()
            for column in columns
        }
        first = next(iter(self._raw), "")
        self._rows = rows if rows is not None else len(self._raw[first])
        for name, array in self._raw.items():
            if len(array) != self._rows:
                raise SceneError(f"{table.called}: column {name} has {len(array)} rows, and {first} has {self._rows}")
        self.kept = np.arange(self._rows)  # indices of the rows of the file that are read
        if any(raw[name].ndim > dimensions for name, dimensions in own.items()):
            steps = Steps([], [])  # each array has its own axis of steps
        mask, note, self.choosing = rows_of_step(section, table, steps, raw, self._rows, units)
        self.notes = [note] if note else []
        if mask is not None:
            self._keep(mask)
        if section.missing is not None and section.missing.leave_out and "position" in mapping:
            # rows without a position are left out
            there = np.ones(self._rows, dtype=np.bool_)
            for column in self._mapping["position"]:
                gaps = np.isnan(numbers_of(self._called, column.name, self._raw[column.name], with_gaps=True))
                there &= ~gaps.reshape(self._rows, -1).any(axis=1)
            before = self._rows
            self._keep(there)
            if self._rows < before:
                gone = counted(before - self._rows, "row")
                self.notes.append(f"{self._called}: {gone} of {before} left out, because a position is missing")

    def _keep(self, mask: BoolArray) -> None:
        self.kept = self.kept[mask]
        self._raw = {name: array[mask] for name, array in self._raw.items()}
        self._rows = len(self.kept)

    def row(self, place: int) -> int:
        """Return the file's row of a body."""
        return int(self.kept[place])

    def vectors(self, quantity: str) -> FloatArray:
        """Return (n, 3) vectors; vectors in a plane have z = 0."""
        columns = self._mapping.get(quantity)
        if columns is None:
            constant = getattr(self._section, quantity, None) or (0.0, 0.0, 0.0)
            return np.tile(np.array(constant), (self._rows, 1))
        if len(columns) == 1:
            return self._numbers(quantity)
        array = np.zeros((self._rows, 3))
        for axis in range(len(columns)):
            array[:, axis] = self._numbers(quantity, axis)
        return array

    def numbers(self, quantity: str) -> FloatArray:
        """Return (n,) numbers."""
        columns = self._mapping.get(quantity)
        if columns is None:
            return np.full(self._rows, float(getattr(self._section, quantity)))
        return self._numbers(quantity)

    def flags(self) -> BoolArray:
        """Return a mask (n,) of the fixed bodies."""
        columns = self._mapping.get("fixed")
        if columns is None:
            return np.full(self._rows, bool(self._section.fixed))
        return flags_of(self._called, columns[0].name, self._raw[columns[0].name])

    def names(self) -> list[str] | None:
        """Return (n,) names; None if there are none."""
        columns = self._mapping.get("name")
        return None if columns is None else texts_of(self._raw[columns[0].name])

    @property
    def used(self) -> list[str]:
        """Notes on the column of each quantity, with the range of its values."""
        return [
            f"{quantity.replace('_', ' ')} from {', '.join(column.shown for column in columns)}{self._range(quantity)}"
            for quantity, columns in self._mapping.items()
        ]

    def _range(self, quantity: str) -> str:
        """Return the range of a quantity as text, with its unit."""
        if quantity not in self._ranges:
            return ""
        least, most = self._ranges[quantity]
        dimensions = DIMENSIONS[quantity]
        if len(dimensions) > 1:
            return f" ({least:.6g} to {most:.6g})"
        if least == most:
            return f" ({self._units.text(least, dimensions[0])})"
        return f" ({self._units.span(least, most, dimensions[0])})"

    def refuse_distance(self, position: FloatArray) -> None:
        """Refuse radii that equal the distances from the origin, since three such spheres would overlap."""
        columns = self._mapping.get("radius")
        if columns is None or len(position) < 3:
            return
        values = self._raw[columns[0].name]
        if values.dtype.kind not in "fiu" or np.shape(values) != (len(position),):
            return
        with np.errstate(over="ignore", invalid="ignore"):
            distance = np.sqrt((position * position).sum(axis=1))
            radius = np.asarray(values, np.float64) * self.factor("radius")
            is_distance = bool(np.all(np.abs(radius - distance) <= _SAME_DISTANCE * distance))
        if is_distance:
            raise question(
                self._called, columns[0], "radius", "the distance from the origin, which it equals in each row"
            )

    def factor(self, quantity: str, place: int = 0) -> float:
        """Return the size of the unit of a column, in units of the simulation."""
        column = self._mapping[quantity][place]
        return column_factor(self._called, column, self._facts, quantity, DIMENSIONS[quantity], self._units)

    def _step(self, quantity: str, name: str, array: Raw, dimensions: int, axis: int) -> Raw:
        """Return a column, or the chosen step of a column with several steps; check the shape."""
        if array.ndim == dimensions + 1:
            array = array.take(step_at(self._called, self._section.snapshot, array.shape[axis], whose=name), axis)
        if array.ndim != dimensions or (dimensions == 2 and array.shape[1] != 3):
            right = "(n, 3)" if dimensions == 2 else "(n,)"
            raise SceneError(f"{self._called}: {name} has the shape {array.shape}, and {quantity} needs {right}")
        return array

    def _numbers(self, quantity: str, place: int = 0) -> FloatArray:
        missing, key = self._section.missing, "radius" if quantity == "diameter" else quantity
        stands = getattr(missing, key, None)  # value that replaces missing values
        column = self._mapping[quantity][place].name
        given = numbers_of(self._called, column, self._raw[column], with_gaps=stands is not None)
        factor = self.factor(quantity, place)
        values = given if factor == 1.0 else given * factor
        gaps = np.isnan(given) | (given == 0.0 if quantity in _SIZES else False)
        if stands is not None and gaps.any():
            values = np.where(gaps, 2.0 * stands if quantity == "diameter" else stands, values)
            shown = self._units.text(stands, DIMENSIONS[key][0])
            lacking = counted(int(gaps.sum()), "row")
            self.notes.append(f"{self._called}: {lacking} of {self._rows} without a {quantity}: {key} = {shown}")
        size = np.abs(values)
        wrong = {
            "is not a finite number": ~np.isfinite(values),
            "must be more than 0": values <= 0.0 if quantity in _POSITIVE else np.zeros(0, np.bool_),
            "must not be negative": values < 0.0 if quantity in _NOT_NEGATIVE else np.zeros(0, np.bool_),
            f"is not between {SMALLEST / factor:.3g} and {LARGEST / factor:.3g} in size; choose other units": (
                (values != 0.0) & ~((size >= SMALLEST) & (size <= LARGEST))
            ),
        }
        for what, rows in wrong.items():
            if rows.any():
                at = np.unravel_index(int(np.argmax(rows)), rows.shape)
                may_replace = gaps[at] and key in Missing.model_fields
                hint = f"; missing = {{ {key} = … }} gives it a value" if may_replace else ""
                row = self.row(int(at[0]))
                raise SceneError(f"{self._called}: column {column}, row {row}: {given[at]:g} {what}{hint}")
        if values.size:
            least, most = self._ranges.get(quantity, (math.inf, -math.inf))
            self._ranges[quantity] = (min(least, float(values.min())), max(most, float(values.max())))
        return values


def columns_of_arrays(
    arrays: Mapping[str, Any], name: str | ArrayLike | None, material: Material | None, units: UnitSystem
) -> BodyColumns:
    """Return the bodies that a Python program passes as arrays; see `Scene.from_arrays`."""
    given = {quantity: value for quantity, value in arrays.items() if value is not None}
    if "position" not in given or "radius" not in given:
        raise SceneError("arrays of bodies need a position and a radius")
    is_dense = "density" in given or (material is not None and material.density is not None and "mass" not in given)
    if ("mass" in given) == is_dense:
        raise SceneError("arrays of bodies need either a mass or a density")
    try:
        bodies = len(given["position"])
    except TypeError:
        raise SceneError("position: needs an array of the shape (n, 3)") from None
    table = {quantity: _row_for_each_body(quantity, value, bodies) for quantity, value in given.items()}
    if name is not None and not isinstance(name, str):
        table["name"] = _row_for_each_body("name", name, bodies)
    return read_columns(BodyData(), Arrays(table), units, material).columns


def _row_for_each_body(quantity: str, value: ArrayLike, bodies: int) -> NDArray[Any]:
    """Return an array with one row per body."""
    shape = (bodies, 3) if quantity in VECTORS else (bodies,)
    if np.ma.is_masked(value):
        mask = np.ma.getmaskarray(np.ma.asarray(value))
        whose = f"body {np.argwhere(mask)[0][0]} has no value" if mask.shape == shape else "there is no value"
        raise SceneError(f"{quantity}: {whose} (it is masked); every body needs one")
    try:
        array = np.asarray(value)
        if array.shape != shape and (array.shape != shape[1:] or quantity == "position"):
            raise ValueError(f"an array of the shape {array.shape}")
        return np.broadcast_to(array, shape)
    except ValueError as error:  # the rows have different lengths
        raise SceneError(f"{quantity}: {error}; {bodies} bodies need the shape {shape}") from None
