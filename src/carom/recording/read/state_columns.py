"""The state of bodies in columns: all tables, arrays and exports of states share one list of quantities."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from carom.arrays import FloatArray, IntArray
from carom.recording.timelines import STEP
from carom.state.checkpoint import Checkpoint
from carom.state.frame import Frame

State: TypeAlias = "Checkpoint | Frame"

VectorsByName = Mapping[str, FloatArray]  # quantity → (n, k), one row for each body
UNIT = "unit"  # key of a unit in the metadata of a field


class StateQuantity(NamedTuple):
    """A quantity that each body has at the end of a step."""

    name: str
    columns: tuple[str, ...]
    unit: str
    # computes the values from state, masses and moments of inertia
    of: Callable[[State, FloatArray, FloatArray], FloatArray | None]


def _kept(name: str) -> Callable[[State, FloatArray, FloatArray], FloatArray | None]:
    return lambda state, mass, inertia: getattr(state, name, None)


def _kinetic(state: State, mass: FloatArray, inertia: FloatArray) -> FloatArray:
    return np.asarray(0.5 * mass * np.sum(state.velocity * state.velocity, axis=1))[:, None]


def _rotational(state: State, mass: FloatArray, inertia: FloatArray) -> FloatArray | None:
    w = state.angular_velocity
    return None if w is None else (0.5 * inertia * np.sum(w * w, axis=1))[:, None]


def _along(name: str) -> tuple[str, ...]:
    return tuple(f"{name}{axis}" for axis in "xyz")


def _spin_change(state: State, mass: FloatArray, inertia: FloatArray) -> FloatArray | None:
    turned = getattr(state, "angular_impulse", None)
    return None if turned is None else turned / inertia[:, None]


# A checkpoint has no torques; a frame has all quantities that its scene models. In the step that ends at a frame,
# lasting contacts cause the torques and the angular accelerations, impacts cause the angular impulses and the changes
# of spin.
STATE_QUANTITIES = (
    StateQuantity("position", _along(""), "m", _kept("position")),
    StateQuantity("velocity", _along("v"), "m/s", _kept("velocity")),
    StateQuantity("orientation", ("qx", "qy", "qz", "qw"), "", _kept("orientation")),
    StateQuantity("angular_velocity", _along("w"), "rad/s", _kept("angular_velocity")),
    # acceleration by forces other than drag and contacts
    StateQuantity("acceleration", _along("a"), "m/s²", _kept("acceleration")),
    StateQuantity("torque", _along("torque_"), "N m", _kept("torque")),
    StateQuantity("angular_acceleration", _along("angular_acceleration_"), "rad/s²", _kept("angular_acceleration")),
    StateQuantity("angular_impulse", _along("angular_impulse_"), "N m s", _kept("angular_impulse")),
    StateQuantity("spin_change", _along("spin_change_"), "rad/s", _spin_change),
    StateQuantity("kinetic_energy", ("kinetic_energy",), "J", _kinetic),
    StateQuantity("rotational_energy", ("rotational_energy",), "J", _rotational),
)
UNITS_OF_BODIES = {"mass": "kg", "radius": "m", "inertia": "kg m²"}


def state_vectors(
    state: State, which: slice | Sequence[int] | IntArray, mass: FloatArray, inertia: FloatArray
) -> dict[str, FloatArray]:
    """Return the quantities of selected bodies in a state, given all masses (kg) and moments of inertia (kg m²)."""
    found = ((quantity.name, quantity.of(state, mass, inertia)) for quantity in STATE_QUANTITIES)
    return {name: values[which] for name, values in found if values is not None}


def state_table(steps: Sequence[int], times: Sequence[float], states: Sequence[VectorsByName]) -> pa.Table:
    """Tabulate states, step by step, with the quantities that all states have; fields have their unit as metadata."""
    each = [len(state["position"]) for state in states]
    columns: dict[str, Any] = {STEP: np.repeat(steps, each), "time": np.repeat(times, each)}
    for quantity in STATE_QUANTITIES:
        if all(quantity.name in state for state in states):
            values = np.concatenate([state[quantity.name] for state in states])
            columns |= in_columns(quantity, values)
    return with_units(pa.table(columns))


def in_columns(quantity: StateQuantity, values: FloatArray) -> dict[str, FloatArray]:
    """Return the columns of a quantity, (n, k)."""
    return dict(zip(quantity.columns, np.ascontiguousarray(values.T), strict=True))


UNITS = {
    "time": "s",
    **{column: quantity.unit for quantity in STATE_QUANTITIES for column in quantity.columns},
    **UNITS_OF_BODIES,
}


def with_units(table: pa.Table, units: Mapping[str, str] = UNITS) -> pa.Table:
    """Return a table whose fields have their unit as metadata."""
    fields = [
        field.with_metadata({UNIT: units[field.name]}) if units.get(field.name) else field for field in table.schema
    ]
    return table.cast(pa.schema(fields, table.schema.metadata))


def units_of(table: pa.Table) -> dict[str, str]:
    """Return the units of the fields that have one."""
    units = {field.name: (field.metadata or {}).get(UNIT.encode(), b"").decode() for field in table.schema}
    return {name: unit for name, unit in units.items() if unit}


class BodyTrajectories(NamedTuple):
    """The paths of several bodies over K frames, as arrays in SI; NaN if a body or a value does not exist."""

    body: IntArray  # (n,) numbers of the bodies
    step: IntArray  # (K,)
    time: FloatArray  # (K,) s
    exact: NDArray[np.bool_]  # (K,) whether positions are in float64, and all other values are known
    vectors: VectorsByName  # quantity → (K, n, k), for example velocity → (K, n, 3) m/s; see `STATE_QUANTITIES`
    source: str

    @property
    def position(self) -> FloatArray:
        """The positions, (K, n, 3) m."""
        return self.vectors["position"]
