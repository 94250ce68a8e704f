"""Scenes from arrays of a Python program."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from carom.errors import SceneError
from carom.scene.conversion import converted, unit_system
from carom.scene.data.body_columns import BodyColumns, read_columns
from carom.scene.data.body_sources import HeldBodies, SourcedBodies
from carom.scene.data.formats import Arrays
from carom.scene.data.mapping import VECTORS
from carom.scene.load import scene_from_dict
from carom.scene.schema.body import BodyData
from carom.scene.schema.contact import Material
from carom.scene.units.system import UnitSystem

if TYPE_CHECKING:
    from carom.scene.schema import Scene


def scene_from_arrays(
    arrays: Mapping[str, ArrayLike | None],
    name: str | ArrayLike | None,
    made_of: str | None,
    sections: Mapping[str, Any],
) -> Scene:
    """Build a scene; see `Scene.from_arrays`."""
    if "bodies" in sections:
        raise SceneError("bodies: the arrays are its bodies; give the other sections only, or use with_bodies")
    return _scene(sections, [], [], arrays, name, made_of)


def scene_with_arrays(scene: Scene, keep: bool, arrays: Mapping[str, Any]) -> Scene:
    """Return a scene with other bodies; see `Scene.with_bodies`."""
    wanted = dict(arrays)
    name, made_of = wanted.pop("name", None), wanted.pop("made_of", None)
    data = tomllib.loads(scene.toml)
    others = {key: value for key, value in data.items() if keep or key not in ("body", "group")}
    held = scene.held if keep else None
    sections, found = ([], []) if held is None else (list(held.sections), list(held.found))
    return _scene(others, sections, found, wanted, name, made_of)


def _scene(
    data: Mapping[str, Any],
    sections: list[BodyData],
    found: list[SourcedBodies],
    arrays: Mapping[str, Any],
    name: str | ArrayLike | None,
    made_of: str | None,
) -> Scene:
    """Build a scene of sections, of bodies that it has, and of arrays."""
    units = unit_system(data.get("units"), [])  # what is wrong with them, the scene itself says
    material = _material(data, made_of)
    columns = _columns(arrays, name, material, units)
    prefix = {"name": name} if isinstance(name, str) else {}
    own = {} if made_of is None else {"material": made_of}
    section = {**prefix, **own, "count": len(columns), "sha256": columns.sha256}
    kept = data.get("bodies", [])[: len(sections)]
    held = HeldBodies(
        (*sections, BodyData.model_validate(section)), (*found, SourcedBodies(columns, columns.sha256, material)), units
    )
    return scene_from_dict({**data, "bodies": [*kept, section]}, held)


def _material(data: Mapping[str, Any], made_of: str | None) -> Material | None:
    """Return the material of a name; None without one, or if it is wrong or unknown, which the scene itself says."""
    numbers, _, _ = converted({key: data[key] for key in ("units", "material") if key in data})
    try:
        return next((Material.model_validate(row) for row in numbers["material"] if row["name"] == made_of), None)
    except (KeyError, TypeError, ValueError):
        return None


def _columns(
    arrays: Mapping[str, Any], name: str | ArrayLike | None, material: Material | None, units: UnitSystem
) -> BodyColumns:
    given = {quantity: value for quantity, value in arrays.items() if value is not None}
    if "position" not in given or "radius" not in given:
        raise SceneError("arrays of bodies need a position and a radius")
    is_dense = "density" in given or (material is not None and material.density is not None and "mass" not in given)
    if ("mass" in given) == is_dense:
        raise SceneError("arrays of bodies need a mass or a density, and not both")
    try:
        bodies = len(given["position"])
    except TypeError:
        raise SceneError("position: needs an array of the shape (n, 3)") from None
    table = {quantity: _array(quantity, value, bodies) for quantity, value in given.items()}
    if name is not None and not isinstance(name, str):
        table["name"] = _array("name", name, bodies)
    return read_columns(BodyData(), Arrays(table), units, material)[0]


def _array(quantity: str, value: ArrayLike, bodies: int) -> NDArray[Any]:
    """Return an array with a row for each body."""
    shape = (bodies, 3) if quantity in VECTORS else (bodies,)
    if np.ma.is_masked(value):
        mask = np.ma.getmaskarray(np.ma.asarray(value))
        whose = f"body {np.argwhere(mask)[0][0]} has no value" if mask.shape == shape else "there is no value"
        raise SceneError(f"{quantity}: {whose} (it is masked); every body needs one")
    try:
        array = np.asarray(value)
        fits = array.shape == shape or (array.shape == shape[1:] and quantity != "position")
        return np.broadcast_to(array, shape) if fits else _refused(array.shape)
    except ValueError as error:  # rows of different lengths
        raise SceneError(f"{quantity}: {error}; {bodies} bodies need the shape {shape}") from None


def _refused(shape: tuple[int, ...]) -> NDArray[Any]:
    raise ValueError(f"an array of the shape {shape}")
