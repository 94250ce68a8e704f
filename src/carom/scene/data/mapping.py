"""The columns of a table that hold each quantity: named by the scene, or with usual names."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from functools import lru_cache

from carom.errors import SceneError
from carom.scene.data import BODY, STEP
from carom.scene.schema.body import BodyData
from carom.scene.schema.contact import Material
from carom.scene.units.dimension import BASE, Dimension, UnitError, nearest_float, unit, unit_of
from carom.scene.units.system import UnitSystem
from carom.scene.wording import suggestion

QUANTITIES = (
    *("position", "velocity", "angular_velocity"),
    *("mass", "density", "radius", "diameter", "inertia", "fixed", "name"),
)
VECTORS = ("position", "velocity", "angular_velocity")
USUAL: dict[str, tuple[str, ...]] = {
    "position": ("position", "positions", "pos", "coordinates", "xyz", "points"),
    "velocity": ("velocity", "velocities", "vel", "v"),
    "angular_velocity": ("angular_velocity", "angular_velocities", "omega", "spin", "angvel"),
    "mass": ("mass", "masses", "m"),
    "density": ("density", "rho"),
    "radius": ("radius", "radii", "r"),
    "diameter": ("diameter", "diameters", "diam"),
    "inertia": ("inertia", "moment_of_inertia"),
    "fixed": ("fixed",),
    "name": ("name", "names", "label"),
}
USUAL_AXES: dict[str, tuple[str, ...]] = {  # with x, y and z instead of the star
    "position": ("*", "p*", "pos*", "pos_*", "position*", "position_*", "*u"),
    "velocity": ("v*", "v_*", "vel*", "vel_*", "velocity*", "velocity_*"),
    "angular_velocity": ("w*", "w_*", "omega*", "omega_*", "angvel*", "angvel_*", "angular_velocity_*"),
}
ELEMENTS = {  # columns of orbital elements; case matters
    "a": ("a", "semi_major_axis", "sma"),
    "q": ("q", "perihelion_distance", "pericentre_distance"),
    "e": ("e", "ecc", "eccentricity"),
    "i": ("i", "inc", "incl", "inclination"),
    "node": ("om", "node", "Omega", "Ω", "raan", "ascending_node"),
    "peri": ("w", "peri", "omega", "ω", "argument_of_pericentre", "argument_of_perihelion"),
    "M": ("ma", "M", "mean_anomaly"),
    "tp": ("tp", "t_p", "T", "time_of_perihelion", "time_of_pericentre"),
    "epoch": ("epoch",),
}
ORIENTED = ("e", "i", "node", "peri")  # the elements that every orbit needs; others may replace each other
_RIVALS = (("mass", "density"), ("radius", "diameter"))  # pairs of quantities that determine each other
_MOST_SHOWN = 12  # columns that a message lists
_MOST_NOTED = 200  # columns that a note lists
_LONGEST_NAME = 40  # characters

# further columns of elements
_ORBIT = frozenset(("a", "e", "ecc", "inc", "incl", "om", "node", "peri", "ma", "tp", "epoch", "moid"))
_SPHERICAL = frozenset(("theta", "phi", "lat", "lon", "ra", "dec", "delta", "rdot", "rr"))
_MEANINGS = {  # names with several meanings: the meanings, and columns that suggest one of them
    "r": ("a distance or a colour", _ORBIT | _SPHERICAL | {"g", "b"}),
    "rho": ("a distance", _SPHERICAL),
    "m": ("a mean anomaly or a magnitude", frozenset[str]()),
}
_WITH_UNIT = re.compile(r"(.*?)\s*(?:\[([^\[\]]+)\]|\(([^()]+)\))\s*")  # "x [au]", "mass (kg)"

_COEFFICIENTS = "[contact] or a [[material]] gives coefficients"
_ELSEWHERE = {  # why some columns of spheres are not used
    **dict.fromkeys(("mu", "friction", "friction_coefficient", "mu_s", "mu_k", "mus", "muk"), _COEFFICIENTS),
    **dict.fromkeys(("restitution", "cor", "coefficient_of_restitution"), _COEFFICIENTS),
    **dict.fromkeys((f"quat{axis}" for axis in "wxyzijk"), "a sphere starts without a rotation"),
    **dict.fromkeys((f"q{axis}" for axis in "wxyz"), "a sphere starts without a rotation"),
    **dict.fromkeys(("orientation", "quaternion", "quat"), "a sphere starts without a rotation"),
    **dict.fromkeys((f"angmom{axis}" for axis in "xyz"), "give an angular velocity"),
    **dict.fromkeys((f"{force}{axis}" for force in ("f", "tq", "torque") for axis in "xyz"), "carom computes forces"),
    **dict.fromkeys(("q", "charge"), "there is no force on charges"),
}

ColumnMapping = dict[str, tuple[str, ...]]  # quantity → one column, or three


def mapping_of(section: BodyData, names: Sequence[str], called: str) -> ColumnMapping:
    """Return the columns of each quantity that has no value in the scene.

    Raises SceneError if a column is missing, or two columns hold the same quantity.
    """
    mapping: ColumnMapping = {}
    for quantity in QUANTITIES:
        asked = getattr(section.columns, quantity)
        if asked is not None:
            columns = (asked,) if isinstance(asked, str) else asked
            mapping[quantity] = tuple(_named(column, names, called, quantity) for column in columns)
        elif not _is_given(section, quantity):
            candidates = _candidates(section, quantity, names)
            if len(candidates) > 1:
                shown = " and ".join(" ".join(columns) for columns in candidates[:2])
                quoted = ", ".join(f'"{column}"' for column in candidates[0])
                column = f"[{quoted}]" if len(candidates[0]) > 1 else quoted
                raise SceneError(
                    f"{called}: two columns for {quantity}, {shown}; select one: columns = {{ {quantity} = {column} }}"
                )
            if candidates:
                _refuse_doubtful(quantity, candidates[0][0], names, called)
                mapping[quantity] = candidates[0]
            elif quantity != "position":  # a missing position is an error
                # a vector with only one or two of the usual columns
                plain = {_plain(name) for name in names}
                for pattern in USUAL_AXES.get(quantity, ()):
                    axes = [pattern.replace("*", axis) for axis in "xyz"]
                    there, missing = ([axis for axis in axes if (axis in plain) is wanted] for wanted in (True, False))
                    if there and missing:
                        raise SceneError(
                            f"{called}: columns for {quantity} are incomplete: {' and '.join(there)} without "
                            f"{' and '.join(missing)}; add the rest, or give {quantity} = [x, y, z] for all bodies"
                        )
    for first, second in _RIVALS:  # the scene must name the column of one
        if first in mapping and second in mapping:
            asked = [quantity for quantity in (first, second) if getattr(section.columns, quantity) is not None]
            if len(asked) != 1:
                raise SceneError(
                    f"{called}: columns for both {first} and {second}, {mapping[first][0]} and {mapping[second][0]}; "
                    f'select one: columns = {{ {first} = "{mapping[first][0]}" }}'
                )
            del mapping[second if asked == [first] else first]
    _refuse_missing(section, mapping, names, called)
    return mapping


def with_material(section: BodyData, material: Material, names: Sequence[str]) -> BodyData:
    """Return a table with values of its material for quantities that neither the table nor a column states."""

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


def unused_columns(section: BodyData, mapping: ColumnMapping, names: Sequence[str]) -> str:
    """List the columns that are not used for bodies, with reasons where known; empty if there are none."""
    used = {column for columns in mapping.values() for column in columns}
    if STEP in names and BODY in names:
        used |= {STEP, BODY}  # step and body select the rows
    given = {quantity for quantity in QUANTITIES if _is_given(section, quantity)}
    usual = {name: quantity for quantity in given for columns in _usual(quantity, names) for name in columns}
    unused = [name for name in names if name not in used]

    def described(name: str) -> str:
        why = f"the scene gives the {usual[name]}" if name in usual else _ELSEWHERE.get(_plain(name), "")
        return printable(name) + (f" ({why})" if why else "")

    listed = ", ".join(map(described, unused[:_MOST_NOTED]))
    more = len(unused) - _MOST_NOTED
    return f"{listed} and {more} more" if more > 0 else listed


def printable(name: str) -> str:
    """Return a name from a file as one short line of text."""
    return "".join(char if char.isprintable() else "�" for char in name[:_LONGEST_NAME])


def unit_in(name: str) -> str:
    """Return the unit in the name of a column, such as "au" in "x [au]"; empty without one."""
    return _split(name.strip())[1]


def elements_in(names: Sequence[str]) -> dict[str, str]:
    """Return the columns of the orbital elements that a table has."""
    plain = {_split(name.strip())[0]: name for name in reversed(names)}
    small = {name.casefold(): column for name, column in plain.items() if not (len(name) == 1 and name.isupper())}
    found = dict[str, str]()
    for element, usual in ELEMENTS.items():
        exact = [plain[name] for name in usual if name in plain]
        alike = [small[name] for name in usual if name.islower() and name in small]
        if columns := [*exact, *(column for column in alike if column not in found.values())]:
            found[element] = columns[0]
    return found


def column_factor(called: str, column: str, quantity: str, dimensions: Sequence[Dimension], units: UnitSystem) -> float:
    """Return the size of a column's unit, stated by its name or the scene, in units of the simulation.

    The dimension of the quantity is the product of ``dimensions``.
    """
    text = unit_in(column)
    if not text or units.dimensionless:
        return math.prod(units.factor(dimension) for dimension in dimensions)
    try:
        if len(dimensions) == 1:
            unit_of(text, dimensions[0])
            return units.number(f"1 {text}", dimensions[0])
        its = unit(text)
        if its.exponents != tuple(sum(each.exponents[k] for each in dimensions) for k in range(len(BASE))):
            raise UnitError(f'"{text}" is not a {quantity.replace("_", " ")}')
    except UnitError as error:
        raise SceneError(f"{called}: column {printable(column)} for {quantity}: {error}") from None
    factor = nearest_float(its.size)
    for dimension in dimensions:
        factor = units.of_si(factor, dimension)
    return factor


@lru_cache(maxsize=10_000)
def _split(name: str) -> tuple[str, str]:
    """Split the name of a column into the name proper and its unit."""
    parts = _WITH_UNIT.fullmatch(name) if name.endswith(("]", ")")) and len(name) <= _MOST_NOTED else None
    if parts is None:
        return name, ""
    text = parts[2] or parts[3]
    try:
        unit(text)
    except UnitError:
        return name, ""
    return parts[1], text


def question(called: str, column: str, quantity: str, others: str) -> SceneError:
    """Return the error for a column that may have another meaning than the usual one."""
    named = f'columns = {{ {quantity} = "{printable(column)}" }}'
    return SceneError(
        f"{called}: column {printable(column)} may be the {quantity}, or {others}; write {named} if it is the "
        f"{quantity}, or give {quantity} = … for all bodies"
    )


def _refuse_doubtful(quantity: str, column: str, names: Sequence[str], called: str) -> None:
    """Refuse a name with several meanings unless other columns confirm the usual one."""
    plain, own = [_plain(name) for name in names], _split(column.strip())[0]
    others, signs = _MEANINGS.get(_plain(column), ("", frozenset[str]()))
    if not others or unit_in(column):
        return
    place = plain.index(_plain(column))
    if "m" in plain[max(0, place - 1) : place + 2] and own == "r" and "M" not in names:  # "m, r", as in REBOUND
        return
    if beside := [name for name, known in zip(names, plain, strict=True) if known in signs]:
        raise question(called, column, quantity, f"{others}, since there is a column {printable(beside[0])}")
    if own == "M" and not {"X", "R"} & {name.strip() for name in names}:
        raise question(called, column, quantity, others)


def _is_given(section: BodyData, quantity: str) -> bool:
    """Return whether the scene has a value for all bodies, so that no column is needed."""
    if quantity in ("mass", "density"):
        return section.mass is not None or section.density is not None
    if quantity == "diameter":
        return section.radius is not None
    if quantity == "inertia":
        return "inertia_factor" in section.model_fields_set
    return quantity != "name" and getattr(section, quantity, None) is not None


def _named(column: str, names: Sequence[str], called: str, quantity: str) -> str:
    """Return the column that the scene names."""
    exact = [name for name in names if name == column] or [name for name in names if _plain(name) == _plain(column)]
    if not exact:
        known = suggestion(column, names) if len(names) <= _MOST_SHOWN else _listed(names)
        raise SceneError(f'{called}: there is no column "{column}" for {quantity}; {known}')
    if len(exact) > 1:
        raise SceneError(f'{called}: {len(exact)} columns are called "{column}"; give each column its own name')
    return exact[0]


def _candidates(section: BodyData, quantity: str, names: Sequence[str]) -> list[tuple[str, ...]]:
    """Return the usual columns of a quantity; none for the inertia if the scene states the radius or the mass."""
    columns = _usual(quantity, names)
    if quantity != "inertia" or not columns:
        return columns
    replaced = (("radius", "diameter"), ("mass", "density"))
    stale = any(_is_given(section, of[0]) and any(_usual(each, names) for each in of) for of in replaced)
    return [] if stale else columns


def _usual(quantity: str, names: Sequence[str]) -> list[tuple[str, ...]]:
    """Return the columns that may hold a quantity: single ones and triples."""
    plain = [_plain(name) for name in names]
    single = [(name,) for name, known in zip(names, plain, strict=True) if known in USUAL[quantity]]
    threes = []
    for pattern in USUAL_AXES.get(quantity, ()):
        axes = [pattern.replace("*", axis) for axis in "xyz"]
        if all(axis in plain for axis in axes):
            repeated = next((axis for axis in axes if plain.count(axis) > 1), None)
            columns = tuple(names[plain.index(axis)] for axis in axes)
            threes += [columns, columns] if repeated else [columns]
    return single + threes


def _plain(name: str) -> str:
    """Return a name for comparisons: in lower case, without a unit, and only the last part of an HDF5 path."""
    return _split(name.strip())[0].rsplit("/", 1)[-1].strip().casefold()


def _refuse_missing(section: BodyData, mapping: ColumnMapping, names: Sequence[str], called: str) -> None:
    """Refuse a table without a position, a radius or a mass."""
    wanted = {
        "position": "x, y and z, or position",
        "radius": "radius or r, or diameter",
        "mass": "mass or m, or density",
    }
    for quantity, usual in wanted.items():
        given = quantity in mapping or _is_given(section, quantity) or dict(_RIVALS).get(quantity) in mapping
        if not given:
            constant = "" if quantity == "position" else f", or give {quantity} = … for all bodies"
            if quantity == "position" and set(ORIENTED) <= set(elements_in(names)):
                raise SceneError(
                    f'{called}: it has orbital elements; write orbit = {{ central_mass = "1 M_sun" }} to read them'
                )
            one = '["…", "…", "…"]' if quantity in VECTORS else '"…"'
            raise SceneError(
                f"{called}: no column for {quantity} (usually {usual}); {_listed(names)}; name it with "
                f"columns = {{ {quantity} = {one} }}{constant}"
            )


def _listed(names: Sequence[str]) -> str:
    shown = ", ".join(map(printable, names[:_MOST_SHOWN]))
    more = f" and {len(names) - _MOST_SHOWN} more" if len(names) > _MOST_SHOWN else ""
    return f"its columns are {shown}{more}" if names else "it has no columns"
