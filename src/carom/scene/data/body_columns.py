"""`BodyColumns`: the bodies of one [[bodies]] table as arrays, read from a data table and checked."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from carom.arrays import BoolArray, FloatArray
from carom.errors import SceneError
from carom.scene.data import Arrays, DataTable, Raw, flags_of, numbers_of, step_at, texts_of
from carom.scene.data.mapping import (
    VECTORS,
    ColumnMapping,
    column_factor,
    mapping_of,
    printable,
    question,
    unit_in,
    unused_columns,
    with_material,
)
from carom.scene.data.orbital_elements import OrbitTable
from carom.scene.schema.body import BodyData, Missing
from carom.scene.schema.contact import Material
from carom.scene.schema.quantity import LARGEST, SMALLEST
from carom.scene.units.dimension import ANGULAR_VELOCITY, DENSITY, LENGTH, MASS, VELOCITY
from carom.scene.units.system import OWN, UnitSystem
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
    name: list[str] | None = None  # (n,); None if they are numbered

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
        """The velocity in m/s if all bodies have the same; otherwise None."""
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
_NOT_NEGATIVE = ("mass", "inertia")  # both are 0 for a test particle
_SIZES = ("radius", "diameter", "density")  # quantities for which 0 is a missing value
_SAME_DISTANCE = 0.02  # relative; distances from the Sun nearly equal distances from the barycentre
_DIMENSIONS = {  # dimensions whose product is the dimension of a quantity
    "position": (LENGTH,),
    "velocity": (VELOCITY,),
    "angular_velocity": (ANGULAR_VELOCITY,),
    "mass": (MASS,),
    "density": (DENSITY,),
    "radius": (LENGTH,),
    "diameter": (LENGTH,),
    "inertia": (MASS, LENGTH, LENGTH),
}


def read_columns(
    section: BodyData, table: DataTable, units: UnitSystem, material: Material | None = None, constant: float = 0.0
) -> tuple[BodyColumns, tuple[str, ...]]:
    """Read and check the bodies of a [[bodies]] table, whose numbers are in the units of the scene.

    ``constant`` is the gravitational constant, for orbital elements. Return the bodies, and notes on used and unused
    columns. Raises SceneError, which names the table, the column and the row.
    """
    if section.orbit is not None:
        table = OrbitTable(table, section.orbit, constant, units)
        own = {"position": table.position, "velocity": table.velocity}
        section = section.model_copy(update={"columns": section.columns.model_copy(update=own)})
    if material is not None:
        section = with_material(section, material, table.names)
    named = [columns for _, columns in section.columns if columns is not None]
    asked = {name for columns in named for name in ((columns,) if isinstance(columns, str) else columns)}
    names = [*table.names, *(name for name in table.hidden if name in asked)]
    mapping = mapping_of(section, names, table.called)
    _refuse_other_units(table, units, mapping)
    wanted = list(dict.fromkeys(column for columns in mapping.values() for column in columns))
    raw = table.read(wanted, texts=mapping.get("name", ()))
    reader = _Reader(section, table.called, mapping, raw, units)
    position = reader.vectors("position")
    if section.columns.radius is None:
        reader.refuse_distance(position)
    n = len(position)
    if n == 0:
        raise SceneError(f"{table.called}: it has no rows")
    if section.count is not None and section.count != n:
        raise SceneError(f"{table.called}: it has {n} rows, but count = {section.count}")
    radius = 0.5 * reader.numbers("diameter") if "diameter" in mapping else reader.numbers("radius")
    fixed = reader.flags()
    has_density = "density" in mapping or section.density is not None
    volume = (4.0 / 3.0) * math.pi * radius * radius * radius
    with np.errstate(over="ignore"):
        mass = reader.numbers("density") * volume if has_density else reader.numbers("mass")
        inertia = section.inertia_ratio * mass * radius * radius if "inertia" not in mapping else None
    columns = BodyColumns(
        position=position,
        velocity=reader.vectors("velocity"),
        angular_velocity=reader.vectors("angular_velocity"),
        mass=mass,
        radius=radius,
        inertia=reader.numbers("inertia") if inertia is None else inertia,
        fixed=fixed,
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
    unused = unused_columns(section, mapping, table.names)
    notes = [f"{table.called}: {'; '.join(reader.used)}"]
    if unused:
        notes.append(f"{table.called}: columns that are not used: {unused}")
    return columns, (*table.notes, *notes, *reader.notes)


class _Reader:
    """Converts the columns of each quantity; values in the scene replace columns."""

    def __init__(
        self, section: BodyData, called: str, mapping: ColumnMapping, raw: dict[str, Raw], units: UnitSystem
    ) -> None:
        self._units = units
        self._section = section
        self._called = called
        self._mapping = mapping
        self._ranges = dict[str, tuple[float, float]]()  # ranges of quantities, in units of the simulation
        self._raw = {
            name: self._snapshot(quantity, name, raw[name]) for quantity in mapping for name in mapping[quantity]
        }
        first = mapping["position"][0]
        self._rows = len(self._raw[first])
        for name, array in self._raw.items():
            if len(array) != self._rows:
                raise SceneError(f"{called}: column {name} has {len(array)} rows, and {first} has {self._rows}")
        self._row = np.arange(self._rows)  # row numbers in the file
        self.notes = list[str]()
        if section.missing is not None and section.missing.leave_out:
            # leave out the rows without a position
            there = np.ones(self._rows, dtype=np.bool_)
            for name in self._mapping["position"]:
                gaps = np.isnan(numbers_of(self._called, name, self._raw[name], with_gaps=True))
                there &= ~gaps.reshape(self._rows, -1).any(axis=1)
            self._row = self._row[there]
            self._raw = {name: array[there] for name, array in self._raw.items()}
            if len(self._row) < self._rows:
                gone = counted(self._rows - len(self._row), "row")
                self.notes.append(f"{self._called}: {gone} of {self._rows} without a position left out")
            self._rows = len(self._row)

    def row(self, place: int) -> int:
        """Return the row of the file from which a body comes."""
        return int(self._row[place])

    def vectors(self, quantity: str) -> FloatArray:
        """Return (n, 3) vectors."""
        columns = self._mapping.get(quantity)
        if columns is None:
            constant = getattr(self._section, quantity, None) or (0.0, 0.0, 0.0)
            return np.tile(np.array(constant), (self._rows, 1))
        if len(columns) == 1:
            return self._numbers(quantity, columns[0])
        array = np.empty((self._rows, 3))
        for axis, column in enumerate(columns):
            array[:, axis] = self._numbers(quantity, column)
        return array

    def numbers(self, quantity: str) -> FloatArray:
        """Return (n,) numbers."""
        columns = self._mapping.get(quantity)
        if columns is None:
            return np.full(self._rows, float(getattr(self._section, quantity)))
        return self._numbers(quantity, columns[0])

    def flags(self) -> BoolArray:
        """Return a mask (n,) of the fixed bodies."""
        columns = self._mapping.get("fixed")
        if columns is None:
            return np.full(self._rows, bool(self._section.fixed))
        return flags_of(self._called, columns[0], self._raw[columns[0]])

    def names(self) -> list[str] | None:
        """Return (n,) names; None if there are none."""
        columns = self._mapping.get("name")
        return None if columns is None else texts_of(self._raw[columns[0]])

    @property
    def used(self) -> list[str]:
        """Notes on the column of each quantity, with the range of its values."""
        return [
            f"{quantity.replace('_', ' ')} from {', '.join(map(printable, columns))}{self._range(quantity)}"
            for quantity, columns in self._mapping.items()
        ]

    def _range(self, quantity: str) -> str:
        """Return the range of a quantity as text, with its unit."""
        if quantity not in self._ranges:
            return ""
        least, most = self._ranges[quantity]
        dimensions = _DIMENSIONS[quantity]
        if len(dimensions) > 1:
            return f" ({least:.6g} to {most:.6g})"
        if least == most:
            return f" ({self._units.text(least, dimensions[0])})"
        return f" ({self._units.span(least, most, dimensions[0])})"

    def refuse_distance(self, position: FloatArray) -> None:
        """Refuse radii that equal the distances from the origin, since three such spheres would overlap."""
        column = self._mapping.get("radius", ("",))[0]
        if not column or len(position) < 3:
            return
        values = self._raw[column]
        if values.dtype.kind not in "fiu" or np.shape(values) != (len(position),):
            return
        with np.errstate(over="ignore", invalid="ignore"):
            distance = np.sqrt((position * position).sum(axis=1))
            radius = np.asarray(values, np.float64) * self._factor("radius", column)
            is_distance = bool(np.all(np.abs(radius - distance) <= _SAME_DISTANCE * distance))
        if is_distance:
            raise question(self._called, column, "radius", "the distance from the origin, which it equals in each row")

    def _factor(self, quantity: str, column: str) -> float:
        """Return the size of a column's unit in units of the simulation."""
        return column_factor(self._called, column, quantity, _DIMENSIONS[quantity], self._units)

    def _snapshot(self, quantity: str, name: str, array: Raw) -> Raw:
        """Return a column or, if it has several steps, the chosen one; check its shape."""
        dimensions = 2 if quantity in VECTORS and len(self._mapping[quantity]) == 1 else 1
        if array.ndim == dimensions + 1:
            array = array[step_at(self._called, self._section.snapshot, len(array), whose=name)]
        if array.ndim != dimensions or (dimensions == 2 and array.shape[1] != 3):
            right = "(n, 3)" if dimensions == 2 else "(n,)"
            raise SceneError(f"{self._called}: {name} has the shape {array.shape}, and {quantity} needs {right}")
        return array

    def _numbers(self, quantity: str, column: str) -> FloatArray:
        missing, key = self._section.missing, "radius" if quantity == "diameter" else quantity
        stands = getattr(missing, key, None)  # replaces missing values
        given = numbers_of(self._called, column, self._raw[column], with_gaps=stands is not None)
        factor = self._factor(quantity, column)
        values = given if factor == 1.0 else given * factor
        gaps = np.isnan(given) | (given == 0.0 if quantity in _SIZES else False)
        if stands is not None and gaps.any():
            values = np.where(gaps, 2.0 * stands if quantity == "diameter" else stands, values)
            shown = self._units.text(stands, _DIMENSIONS[key][0])
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
                place = np.unravel_index(int(np.argmax(rows)), rows.shape)
                may_replace = gaps[place] and key in Missing.model_fields
                hint = f"; missing = {{ {key} = … }} gives it a value" if may_replace else ""
                row = self.row(int(place[0]))
                raise SceneError(f"{self._called}: column {column}, row {row}: {given[place]:g} {what}{hint}")
        if values.size:
            least, most = self._ranges.get(quantity, (math.inf, -math.inf))
            self._ranges[quantity] = (min(least, float(values.min())), max(most, float(values.max())))
        return values


def _refuse_other_units(table: DataTable, units: UnitSystem, mapping: ColumnMapping) -> None:
    """Refuse a table in other units than the scene."""
    if not table.units or units.dimensionless:
        return
    its = UnitSystem.of_text(table.units)
    if its.dimensionless:
        if units.given:  # the scene says what they are
            return
        raise SceneError(
            f'{table.called}: its numbers have no units; write units = "{table.units}" at the top of the scene, or '
            "[units] with their length, time and mass"
        )
    read = (
        dimension
        for quantity, columns in mapping.items()
        if not all(map(unit_in, columns))
        for dimension in _DIMENSIONS.get(quantity, ())
    )
    other = next((dimension for dimension in read if not units.agrees(its, dimension)), None)
    if other is None:
        return
    named = ", ".join(
        f'{dimension.plain} = "{unit}"' for dimension, unit in zip(OWN, table.units.split(", "), strict=True)
    )
    scene = "those of the scene in SI" if units.is_si else f"the scene has {other.name} in {units.unit(other)}"
    raise SceneError(
        f"{table.called}: its numbers are in {table.units}, and {scene}; write units = "
        f'"{table.units}" at the top of the scene, or [units] with {named}'
    )


def columns_of_arrays(
    arrays: Mapping[str, Any], name: str | ArrayLike | None, material: Material | None, units: UnitSystem
) -> BodyColumns:
    """Return the bodies that a Python program gives as arrays; see `Scene.from_arrays`."""
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
    return read_columns(BodyData(), Arrays(table), units, material)[0]


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
    except ValueError as error:  # rows of different lengths
        raise SceneError(f"{quantity}: {error}; {bodies} bodies need the shape {shape}") from None
