"""The bodies of [[bodies]] at time 0 as a recording stores them.

Masses, radii, moments of inertia and names are those of all bodies, and are not stored twice.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from carom.errors import DamageError
from carom.recording.schema.checkpoint import LARGEST
from carom.scene.data.body_columns import BodyColumns
from carom.scene.data.mapping import VECTORS

if TYPE_CHECKING:
    from carom.recording.read.body_table import BodyTable

FloatArray = NDArray[np.float64]


def encode(data: Sequence[BodyColumns]) -> dict[str, Any]:
    """Return the components; those that are zero for all bodies are left out."""
    vectors = {name: np.concatenate([getattr(columns, name) for columns in data]).ravel() for name in VECTORS}
    kept = {name: values for name, values in vectors.items() if name == "position" or values.any()}
    fixed = np.concatenate([columns.fixed for columns in data])
    named = np.array([columns.name is not None for columns in data])
    return {**kept, **({"fixed": fixed} if fixed.any() else {}), "named": named}


def decode(
    stored: Mapping[str, NDArray[Any] | list[str]], index: int, row: int, place: range, bodies: BodyTable
) -> BodyColumns:
    """Undo `encode` for one [[bodies]].

    Parameters
    ----------
    stored
        The components.
    index
        Which [[bodies]] of the scene.
    row
        Of its first body in the components.
    place
        Numbers of its bodies.
    bodies
        All bodies of the recording.

    Raises
    ------
    DamageError
        If the components do not have these bodies, or are not finite.
    """
    n, own, named = len(place), slice(row, row + len(place)), np.asarray(stored["named"])
    whole = np.asarray(stored["position"]).size // 3
    if place.stop > len(bodies.mass) or row + n > whole or named.dtype != np.bool_ or index >= named.size:
        raise DamageError("its scene has more bodies than it")
    fixed = np.asarray(stored.get("fixed", np.zeros(whole, np.bool_)))
    if fixed.shape != (whole,) or fixed.dtype != np.bool_:
        raise DamageError("it does not say of each body whether it is fixed")
    numbers = slice(place.start, place.stop)
    return BodyColumns(
        position=_vectors(stored, "position", whole)[own],
        velocity=_vectors(stored, "velocity", whole)[own],
        angular_velocity=_vectors(stored, "angular_velocity", whole)[own],
        mass=bodies.mass[numbers],
        radius=bodies.radius[numbers],
        inertia=bodies.inertia[numbers],
        fixed=fixed[own],
        name=list(bodies.name[numbers]) if named[index] else None,
    )


def _vectors(stored: Mapping[str, NDArray[Any] | list[str]], name: str, n: int) -> FloatArray:
    values = np.asarray(stored.get(name, np.zeros(3 * n)))
    if values.shape != (3 * n,) or values.dtype != np.float64 or not np.all(np.abs(values) <= LARGEST):
        raise DamageError(f"{name} of the bodies of its scene is not {n} finite vectors")
    return values.reshape(n, 3)
