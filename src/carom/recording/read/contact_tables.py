"""Tables of contacts and impacts: their columns, and how rows of the contact table become one."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from carom.errors import DamageError, RecordingError, SceneError
from carom.physics.contact.contact_table import MODES

FloatArray = NDArray[np.float64]
if TYPE_CHECKING:
    from carom.recording.read.recording import Recording

IntArray = NDArray[np.int64]

SCHEMA = pa.schema(
    [
        ("step", pa.int64()),
        ("time", pa.float64()),  # s, of the impact, or the end of the step
        ("i", pa.int64()),  # i < j
        ("j", pa.int64()),  # from n on: planes and walls
        *((name, pa.float64()) for name in ("x", "y", "z")),  # m, the contact point
        *((name, pa.float64()) for name in ("nx", "ny", "nz")),  # the normal, from i to j
        ("approach_speed", pa.float64()),  # m/s
        ("normal_impulse", pa.float64()),  # N s
        ("tangential_impulse", pa.float64()),  # N s
        ("mode", pa.string()),
        ("energy_lost", pa.float64()),  # J
    ]
)
MEASURED = ("approach_speed", "normal_impulse", "tangential_impulse", "energy_lost")  # recorded in float32
UNITS = {  # of the columns that have one
    "time": "s",
    **dict.fromkeys(("x", "y", "z"), "m"),
    "approach_speed": "m/s",
    **dict.fromkeys(("normal_impulse", "tangential_impulse"), "N s"),
    "energy_lost": "J",
}
SOURCE = "source"  # key of a table's metadata: where its rows come from, in words


def table_of(columns: Mapping[str, Any], source: str) -> pa.Table:
    """Make a table of columns; those that are not there are null."""
    rows = len(columns["step"])
    arrays = [
        pa.array(columns[field.name], field.type) if field.name in columns else pa.nulls(rows, field.type)
        for field in SCHEMA
    ]
    return pa.table(arrays, schema=SCHEMA).replace_schema_metadata({SOURCE: source})


def table_of_rows(rows: NDArray[np.void], source: str) -> pa.Table:
    """Make a table of rows, (k,) `CONTACT_ROW`."""
    plain = ("step", "time", "i", "j", "x", "y", "z", "nx", "ny", "nz", "approach_speed", "normal_impulse")
    columns: dict[str, Any] = {name: np.ascontiguousarray(rows[name]) for name in plain}
    friction = np.stack([rows["friction_x"], rows["friction_y"], rows["friction_z"]])
    columns["tangential_impulse"] = np.sqrt(np.sum(friction * friction, axis=0))
    columns["energy_lost"] = rows["restitution_loss"] + rows["friction_loss"]
    return table_of(columns | {"mode": modes(rows["mode"], "a replay")}, source)


def finite(recorded: pa.Table, repeat: Callable[[], pa.Table]) -> pa.Table:
    """Return a recorded table, or the one of a replay where a value was too large for float32, above 3.4e38.

    A run that cannot be repeated keeps its infinite numbers.
    """
    if any(bool(np.isinf(recorded[name].to_numpy()).any()) for name in MEASURED):
        with suppress(RecordingError, SceneError):
            return repeat()
    return recorded


def modes(numbers: NDArray[np.uint8], path: str) -> pa.Array:
    """Return the modes of contacts as texts."""
    if len(numbers) and int(numbers.max()) >= len(MODES):
        raise DamageError(f"/{path} has a contact in a mode that there is not")
    return pa.array(MODES).take(pa.array(numbers))


def of_body(table: pa.Table, body: int | None) -> pa.Table:
    """Keep the rows of a body; None keeps all."""
    if body is None:
        return table
    own = (table["i"].to_numpy() == body) | (table["j"].to_numpy() == body)
    return table.filter(pa.array(own))


def of_shown(table: pa.Table, recording: Recording) -> pa.Table:
    """Keep the rows of bodies that a recording shows, among each other or with planes."""
    if recording.shows_all:
        return table
    pairs = np.stack([table["i"].to_numpy(), table["j"].to_numpy()], axis=1)
    return table.filter(pa.array(join_some(pairs, recording.shown, int(recording.info["bodies"]))))


def join_some(pairs: IntArray, chosen: Sequence[int] | IntArray, bodies: int) -> NDArray[np.bool_]:
    """Tell which pairs (k, 2) join chosen ones of some ``bodies``, or a chosen body and a plane."""
    among = np.isin(pairs, chosen)
    return np.asarray(among[:, 0] & (among[:, 1] | (pairs[:, 1] >= bodies)))


def check_pairs(pairs: IntArray, bodies: int, path: str) -> None:
    """Refuse pairs (k, 2) that cannot be. DamageError if there are any."""
    if np.any((pairs[:, 0] >= pairs[:, 1]) | (pairs[:, 0] >= bodies)):
        raise DamageError(f"/{path} has contacts of bodies that are not there")
