"""How a recorded value differs from the replayed one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from carom.recording.schema import paths
from carom.recording.schema.series import SERIES

Value = float | str

_UNITS = {  # of the components of checkpoints and of impacts
    "approach_speed": "m/s",
    "energy_lost": "J",
    "position": "m",
    "velocity": "m/s",
    "acceleration": "m/s²",
    "angular_velocity": "rad/s",
    "normal_impulse": "N s",
    "tangential_impulse": "N s",
    "time": "s",
    "previous_dt": "s",
    "contact_rest_speed": "m/s",
    "contact_dt": "s",
    "held_impulse": "N s",
    "held_kick": "s",
    "integrator_last_dt": "s",
    "integrator_position_rest": "m",
    "integrator_velocity_rest": "m/s",
    "integrator_accepted": "m/s²",
    "integrator_correction": "m/s²",
    "orbit_near": "m",
    "orbit_position": "m",
    "orbit_velocity": "m/s",
    "sleep_reference": "m/s²",
}
_ENERGIES = ("energy_", "ledger_")  # how those of a checkpoint begin


@dataclass(frozen=True, slots=True)
class Mismatch:
    """A recorded value that differs in the replayed frame."""

    step: int
    quantity: str
    recorded: Value
    replayed: Value
    body: int | None = None
    unit: str = ""  # of both values, in SI; empty: none is known


def same(recorded: pa.Array, replayed: pa.Array) -> bool:
    """Tell whether two columns have the same bits in rows of the same lengths."""
    if pa.types.is_list(recorded.type):
        lengths = [pc.list_value_length(column) for column in (recorded, replayed)]
        if not lengths[0].equals(lengths[1]):
            return False
    one, other = _flat(recorded), _flat(replayed)
    return one.dtype == other.dtype and one.tobytes() == other.tobytes()


def different(step: int, path: str, name: str, recorded: pa.Array, replayed: pa.Array) -> Mismatch | None:
    """Compare the values of a row; name the first that differs."""
    one, other = _flat(recorded), _flat(replayed)
    quantity = f"/{path}" if name == "Scalars:scalars" else f"{name} of /{path}"
    if len(one) != len(other):
        return Mismatch(step, f"how many values {quantity} has", len(one), len(other))
    if one.dtype.kind != other.dtype.kind or (one.dtype.kind != "S" and one.dtype != other.dtype):
        return Mismatch(step, f"type of {quantity}", str(one.dtype), str(other.dtype))
    if one.tobytes() == other.tobytes():
        return None
    if one.dtype.kind == "S":
        return Mismatch(step, quantity, bytes(one[0]).decode(), bytes(other[0]).decode())
    k = int(np.flatnonzero(one.view(np.uint8) != other.view(np.uint8))[0]) // one.itemsize
    body = k // 3 if name in paths.CENTRES else None
    return Mismatch(step, quantity, one[k].item(), other[k].item(), body, _unit(path, name))


def _unit(path: str, name: str) -> str:
    """Name the SI unit of the numbers of a component; empty if they have none, or several."""
    if name in paths.CENTRES:
        return "m"
    if path == paths.CHECKPOINT and name.startswith(_ENERGIES):
        return "J"
    return _UNITS.get(name) or next((series.unit for series in SERIES if series.path == path), "")


def _flat(row: pa.Array) -> NDArray[np.generic]:
    """Return the numbers of a row, or its text as one value of bytes."""
    values = row
    while pa.types.is_nested(values.type):
        values = values.flatten()
    if pa.types.is_string(values.type):
        return np.array(["\0".join(values.to_pylist()).encode()])
    return np.ascontiguousarray(values.to_numpy(zero_copy_only=False))
