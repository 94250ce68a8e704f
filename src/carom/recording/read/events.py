"""Reads the events of a run."""

from __future__ import annotations

import numpy as np
import pyarrow as pa

from carom.physics.event import Event
from carom.recording.read import tables
from carom.recording.read.entities import Entities
from carom.recording.schema import paths
from carom.recording.schema.event_kinds import CLOSING, kind_of
from carom.recording.schema.timelines import SIM_TIME, STEP


def event_table(entities: Entities) -> pa.Table:
    """Return the events in the order of steps; see `Recording.events`."""
    table = entities.table(paths.EVENTS, tables.EVENTS, optional=("kind",))
    table = table.rename_columns([name.removeprefix("TextLog:") for name in table.column_names])
    told = zip(table["kind"].to_pylist(), table["text"].to_pylist(), strict=True)
    kinds = pa.array([kind_of(kind, text) for kind, text in told], pa.string())
    table = table.set_column(table.column_names.index("kind"), "kind", kinds)
    # events logged at the end are about earlier steps
    return table.take(np.argsort(table[STEP].to_numpy(), kind="stable"))


def warnings_of(events: pa.Table, time_scale: float, until: int | None) -> list[Event]:
    """Return the warnings up to a step; see `Recording.warnings`."""
    seconds = events[SIM_TIME].cast(pa.int64()).to_numpy() * 1e-9 * time_scale
    columns = (events[name].to_pylist() for name in ("level", "text", "kind"))
    found = [Event(*row) for row in zip(events[STEP].to_pylist(), seconds.tolist(), *columns, strict=True)]
    return [
        event
        for event in found
        if event.level == "WARN" and event.kind not in CLOSING and (until is None or event.step <= until)
    ]
