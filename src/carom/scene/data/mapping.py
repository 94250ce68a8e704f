"""Which columns of a table hold which quantity: as the scene says, or by their usual names."""

from __future__ import annotations

from collections.abc import Sequence

from carom.scene.error import SceneError
from carom.scene.nearest import suggestion
from carom.scene.schema.bodies import BodyData
from carom.scene.schema.material import Material

QUANTITIES = ("position", "velocity", "angular_velocity", "mass", "density", "radius", "inertia", "fixed", "name")
VECTORS = ("position", "velocity", "angular_velocity")
USUAL: dict[str, tuple[str, ...]] = {
    "position": ("position", "positions", "pos", "coordinates", "xyz", "points"),
    "velocity": ("velocity", "velocities", "vel", "v"),
    "angular_velocity": ("angular_velocity", "omega", "spin"),
    "mass": ("mass", "masses", "m"),
    "density": ("density", "rho"),
    "radius": ("radius", "radii", "r"),
    "inertia": ("inertia", "moment_of_inertia"),
    "fixed": ("fixed",),
    "name": ("name", "names", "label"),
}
USUAL_AXES: dict[str, tuple[str, ...]] = {  # before x, y and z
    "position": ("", "pos_", "position_", "p"),
    "velocity": ("v", "vel_", "velocity_", "v_"),
    "angular_velocity": ("w", "omega_", "angular_velocity_", "w_"),
}
_RIVALS = (("mass", "density"),)  # of which one follows from the other
_MOST_SHOWN = 12  # columns that a message lists

Mapping = dict[str, tuple[str, ...]]  # quantity → one column, or three


def mapping_of(section: BodyData, names: Sequence[str], called: str) -> Mapping:
    """Find the columns of each quantity that the scene gives no value for.

    Raises
    ------
    SceneError
        If a column is missing, or two hold the same quantity.
    """
    found: Mapping = {}
    for quantity in QUANTITIES:
        asked = getattr(section.columns, quantity)
        if asked is not None:
            found[quantity] = tuple(_named(column, names, called, quantity) for column in _several(asked))
        elif not _is_given(section, quantity):
            candidates = _candidates(section, quantity, names)
            if len(candidates) > 1:
                raise SceneError(_ambiguous(quantity, candidates, called))
            if candidates:
                found[quantity] = candidates[0]
            elif quantity != "position":  # which is refused as missing
                _refuse_part(quantity, names, called)
    for first, second in _RIVALS:
        _refuse_rivals(section, found, first, second, called)
    _refuse_missing(section, found, names, called)
    return found


def with_material(section: BodyData, material: Material, names: Sequence[str]) -> BodyData:
    """Return a section with what its material gives and neither the section nor a column does."""

    def is_known(*quantities: str) -> bool:
        return any(
            getattr(section.columns, quantity) is not None
            or _is_given(section, quantity)
            or _candidates(section, quantity, names)
            for quantity in quantities
        )

    density = material.density if material.density is not None and not is_known("mass", "density") else None
    factor = material.inertia_factor if material.inertia_factor is not None and not is_known("inertia") else None
    given = {"density": density, "inertia_factor": factor}
    return section.model_copy(update={key: value for key, value in given.items() if value is not None})


def _several(asked: str | tuple[str, ...]) -> tuple[str, ...]:
    return (asked,) if isinstance(asked, str) else asked


def _is_given(section: BodyData, quantity: str) -> bool:
    """Tell whether the scene itself says what the bodies have in common, so that no column is looked for."""
    if quantity in ("mass", "density"):
        return section.mass is not None or section.density is not None
    if quantity == "inertia":
        return "inertia_factor" in section.model_fields_set
    return quantity != "name" and getattr(section, quantity, None) is not None


def _named(column: str, names: Sequence[str], called: str, quantity: str) -> str:
    """Find a column by the name that the scene gives it."""
    exact = [name for name in names if name == column] or [name for name in names if _plain(name) == _plain(column)]
    if not exact:
        raise SceneError(f'{called}: there is no column "{column}" for {quantity}; {_nearest(column, names)}')
    if len(exact) > 1:
        raise SceneError(f'{called}: {len(exact)} columns are called "{column}"; give each column its own name')
    return exact[0]


def _candidates(section: BodyData, quantity: str, names: Sequence[str]) -> list[tuple[str, ...]]:
    """Return the usual columns of a quantity; no inertia, if it is that of a radius or mass that the scene replaces."""
    columns = _usual(quantity, names)
    if quantity != "inertia" or not columns:
        return columns
    replaced = (("radius",), ("mass", "density"))
    stale = any(_is_given(section, of[0]) and any(_usual(each, names) for each in of) for of in replaced)
    return [] if stale else columns


def _usual(quantity: str, names: Sequence[str]) -> list[tuple[str, ...]]:
    """Return the columns that may hold a quantity: single ones, and threes."""
    plain = [_plain(name) for name in names]
    single = [(name,) for name, known in zip(names, plain, strict=True) if known in USUAL[quantity]]
    threes = []
    for before in USUAL_AXES.get(quantity, ()):
        axes = [f"{before}{axis}" for axis in "xyz"]
        if all(axis in plain for axis in axes):
            repeated = next((axis for axis in axes if plain.count(axis) > 1), None)
            columns = tuple(names[plain.index(axis)] for axis in axes)
            threes += [columns, columns] if repeated else [columns]
    return single + threes


def _refuse_part(quantity: str, names: Sequence[str], called: str) -> None:
    """Refuse a vector of which a table has one or two of the usual columns."""
    plain = {_plain(name) for name in names}
    for before in USUAL_AXES.get(quantity, ()):
        axes = [f"{before}{axis}" for axis in "xyz"]
        there, missing = ([axis for axis in axes if (axis in plain) is wanted] for wanted in (True, False))
        if there and missing:
            raise SceneError(
                f"{called}: columns for {quantity} are incomplete: {' and '.join(there)} without "
                f"{' and '.join(missing)}; add the rest, or give {quantity} = [x, y, z] for all bodies"
            )


def _plain(name: str) -> str:
    """Return what is compared of a name: of a path in HDF5 the last part."""
    return name.rsplit("/", 1)[-1].strip().casefold()


def _ambiguous(quantity: str, candidates: Sequence[tuple[str, ...]], called: str) -> str:
    shown = " and ".join(" ".join(columns) for columns in candidates[:2])
    quoted = ", ".join(f'"{column}"' for column in candidates[0])
    column = f"[{quoted}]" if len(candidates[0]) > 1 else quoted
    return f"{called}: two columns for {quantity}, {shown}; say which: columns = {{ {quantity} = {column} }}"


def _refuse_rivals(section: BodyData, found: Mapping, first: str, second: str, called: str) -> None:
    """Refuse two quantities of which one follows from the other; what the scene names is preferred."""
    if first in found and second in found:
        asked = [quantity for quantity in (first, second) if getattr(section.columns, quantity) is not None]
        if len(asked) != 1:
            raise SceneError(
                f"{called}: columns for {first} and for {second}, {found[first][0]} and {found[second][0]}; "
                f'say which: columns = {{ {first} = "{found[first][0]}" }}'
            )
        del found[second if asked == [first] else first]


def _refuse_missing(section: BodyData, found: Mapping, names: Sequence[str], called: str) -> None:
    """Refuse a table without a position, a radius or a mass."""
    wanted = {
        "position": "x, y and z, or position",
        "radius": "radius or r",
        "mass": "mass or m, or density",
    }
    for quantity, usual in wanted.items():
        given = quantity in found or _is_given(section, quantity) or (quantity == "mass" and "density" in found)
        if not given:
            constant = "" if quantity == "position" else f", or give {quantity} = … for all bodies"
            one = '["…", "…", "…"]' if quantity in VECTORS else '"…"'
            raise SceneError(
                f"{called}: no column for {quantity} (usually {usual}); {_listed(names)}; name it with "
                f"columns = {{ {quantity} = {one} }}{constant}"
            )


def _nearest(column: str, names: Sequence[str]) -> str:
    return suggestion(column, names) if len(names) <= _MOST_SHOWN else _listed(names)


def _listed(names: Sequence[str]) -> str:
    shown = ", ".join(str(name)[:40] for name in names[:_MOST_SHOWN])
    more = f" and {len(names) - _MOST_SHOWN} more" if len(names) > _MOST_SHOWN else ""
    return f"its columns are {shown}{more}" if names else "it has no columns"
