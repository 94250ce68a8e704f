"""Reads the scalars below an entity, such as the energies, as one table."""

from __future__ import annotations

from functools import reduce

import numpy as np
import pyarrow as pa

from carom.recording.read import tables
from carom.recording.read.entities import Entities
from carom.recording.schema.timelines import SIM_TIME, STEP


def scalar_series(entities: Entities, root: str, names: tuple[str, ...], frames: pa.Table) -> pa.Table:
    """Return some scalars below an entity, or all, of the frames that have a value in each.

    A run that was killed may have sent half a batch, and of a repaired one any piece may be missing: a scalar that has
    no rows is left out.

    Parameters
    ----------
    frames
        Columns step, sim_time and time of all frames.
    """
    paths = entities.below(root)
    parts: dict[str, pa.Table] = {}
    for name in names or paths:
        chunks = entities.chunks(paths[name], "Scalars:scalars") if name in paths else iter(())
        found = tables.table(f"{root}/{name}", chunks, tables.SCALARS)
        if found.num_rows:
            parts[name] = found
    columns = {name: frames[name] for name in (STEP, SIM_TIME, "time")}
    columns |= {name: part["Scalars:scalars"] for name, part in parts.items()}
    steps = {name: part[STEP].to_numpy() for name, part in parts.items()}
    own = frames[STEP].to_numpy()
    if all(np.array_equal(column, own) for column in steps.values()):
        return pa.table(columns)
    common = reduce(np.intersect1d, steps.values(), own)
    places = {name: np.searchsorted(steps.get(name, own), common) for name in columns}
    return pa.table({name: column.take(pa.array(places[name])) for name, column in columns.items()})
