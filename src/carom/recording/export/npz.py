"""NumPy's .npz: arrays whose first axis runs over the steps."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa

from carom.recording.read.state_columns import STATE_QUANTITIES, UNITS_OF_BODIES, units_of

if TYPE_CHECKING:
    from carom.recording.export import Snapshot


def write_npz(path: Path, first: Snapshot, others: Iterator[Snapshot]) -> None:
    """Write step and time (K,), values such as body and mass (n,), and vectors such as position (K, n, 3 or 4).

    If bodies come and go, n is the number of all bodies; vectors of a body that does not exist are NaN. Arrays that
    begin with ``contact_`` have a row for each contact of each step, and arrays that begin with ``energy_`` have a
    number for each step (J). ``units`` is a JSON text with the unit of each array that has one.
    """
    every = [first, *others]
    body, rows = np.unique(np.concatenate([each.body for each in every]), return_index=True)
    stacked: dict[str, Any] = {}
    for name, like in first.vectors.items():
        stacked[name] = np.full((len(every), len(body), like.shape[1]), np.nan)
        for found, each in zip(stacked[name], every, strict=True):
            found[np.searchsorted(body, each.body)] = each.vectors[name]
    step, time = np.array([each.step for each in every]), np.array([each.time for each in every])
    values = {"mass": [each.mass for each in every], "radius": [each.radius for each in every]}
    values |= {name: [each.others[name] for each in every] for name in first.others}
    contacts = [each.contacts for each in every if each.contacts is not None]
    table = pa.concat_tables(contacts) if contacts else pa.table({})
    touching = {f"contact_{name}": _plain(table[name]) for name in table.column_names}
    energies = {f"energy_{name}": np.array([each.energies[name] for each in every]) for name in first.energies}
    units = {"time": "s", **UNITS_OF_BODIES, **{quantity.name: quantity.unit for quantity in STATE_QUANTITIES}}
    units |= {f"contact_{name}": unit for name, unit in units_of(table).items()}
    units |= dict.fromkeys(energies, "J")
    own = {"body": body, **{name: np.concatenate(arrays)[rows] for name, arrays in values.items()}}
    told = np.array(json.dumps({name: unit for name, unit in units.items() if unit}, ensure_ascii=False))
    arrays: dict[str, Any] = {"step": step, "time": time, **own, **stacked, **touching, **energies, "units": told}
    with path.open("wb") as file:  # given a name, NumPy would append .npz
        np.savez(file, **arrays)


def _plain(column: pa.ChunkedArray) -> Any:
    """Return a column as an array of numbers or of text; missing numbers are NaN."""
    return np.array(column.to_pylist(), np.str_) if pa.types.is_string(column.type) else column.to_numpy()
