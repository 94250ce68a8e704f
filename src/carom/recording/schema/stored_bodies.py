"""Names of bodies, and the initial bodies of [[bodies]] tables, as stored in a recording.

Numbered names are stored by their prefix. Masses, radii, moments of inertia and names of [[bodies]] tables are stored
once, together with those of all bodies.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from carom.arrays import FloatArray
from carom.errors import DamageError
from carom.recording.schema.properties import LARGEST
from carom.scene.data.body_columns import BodyColumns
from carom.scene.data.mapping import VECTORS
from carom.scene.wording import JoinedNames, NumberedNames, joined

if TYPE_CHECKING:
    from carom.recording.read.statics import BodyTable


Stored = Mapping[str, NDArray[Any] | list[str]]

_COUNT, _FIRST = "name_count", "name_first"


def encode_names(names: Sequence[str]) -> dict[str, Any]:
    """Return the components that hold the names.

    Without numbered names, the only component is ``name``. Otherwise ``name_count`` is the number of bodies with a
    prefix (0 for a complete name), and ``name_first`` the number in the name of the first of these bodies.
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
        raise DamageError("names of its bodies do not have one number each")
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


def decode_bodies(
    stored: Mapping[str, NDArray[Any] | list[str]], index: int, row: int, place: range, bodies: BodyTable
) -> BodyColumns:
    """Undo `encode` for one [[bodies]] table.

    Parameters
    ----------
    stored
        The components.
    index
        Index of the [[bodies]] table in the scene.
    row
        Row of its first body in the components.
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
        raise DamageError("it does not state for each body whether it is fixed")
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
