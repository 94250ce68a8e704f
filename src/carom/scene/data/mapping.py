"""The columns of a table that hold each quantity: columns that the scene names, or columns with usual names."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

from carom.errors import SceneError
from carom.scene.data import DataTable
from carom.scene.data.facts import Facts, FileColumn, column_named, columns_of, printable
from carom.scene.schema.body import BodyData
from carom.scene.schema.contact import Material
from carom.scene.units.dimension import ANGLE, ANGULAR_VELOCITY, DENSITY, LENGTH, MASS, TIME, VELOCITY, Dimension
from carom.scene.wording import suggestion

QUANTITIES = (
    *("position", "velocity", "angular_velocity"),
    *("mass", "density", "radius", "diameter", "inertia", "fixed", "name"),
)
VECTORS = ("position", "velocity", "angular_velocity")
DIMENSIONS: dict[str, tuple[Dimension, ...]] = {  # dimensions whose product is the dimension of a quantity
    "position": (LENGTH,),
    "velocity": (VELOCITY,),
    "angular_velocity": (ANGULAR_VELOCITY,),
    "mass": (MASS,),
    "density": (DENSITY,),
    "radius": (LENGTH,),
    "diameter": (LENGTH,),
    "inertia": (MASS, LENGTH, LENGTH),
}
# Usual names of columns in all formats, as `FileColumn.plain` writes them; case and separators do not matter.
USUAL: dict[str, tuple[str, ...]] = {
    "position": ("position", "positions", "pos", "coordinates", "xyz", "points"),
    "velocity": (
        *("velocity", "velocities", "vel", "velo", "v"),
        *("linvelvec", "linvel", "linearvelocity", "linearvelocities"),  # linVelVec is a name of YADE
    ),
    "angular_velocity": (
        *("angularvelocity", "angularvelocities", "omega", "omegas", "spin", "angvel"),
        *("angvelvec", "rotationalvelocity"),
    ),
    "mass": ("mass", "masses", "m"),
    "density": ("density", "rho"),
    "radius": ("radius", "radii", "r"),
    "diameter": ("diameter", "diameters", "diam"),
    "inertia": ("inertia", "momentofinertia"),
    "fixed": ("fixed",),
    "name": ("name", "names", "label", "fullname"),
}
USUAL_AXES: dict[str, tuple[str, ...]] = {  # names with x, y and z in place of the star
    "position": ("*", "p*", *(f"{name}*" for name in USUAL["position"]), "*u", "*position", "*pos"),
    "velocity": (*(f"{name}*" for name in USUAL["velocity"]), "*velocity", "*vel"),
    "angular_velocity": ("w*", *(f"{name}*" for name in USUAL["angular_velocity"]), "*angularvelocity"),
}
_LOST = {  # beginnings of unknown names of vectors that may hold a quantity
    "velocity": ("v", "lin", "momenta", "momentum"),
    "angular_velocity": ("ang", "om", "rot", "spin"),
}
ELEMENTS = {  # columns of orbital elements; case matters
    "a": ("a", "semi_major_axis", "sma"),
    "q": ("q", "perihelion_distance", "pericentre_distance"),
    "e": ("e", "ecc", "eccentricity"),
    "i": ("i", "inc", "incl", "inclination"),
    "node": (
        *("om", "node", "Omega", "Ω", "raan", "ascending_node"),
        *("longitude_of_ascending_node", "longitude_ascending_node", "longitude_of_the_ascending_node"),
    ),
    "peri": (
        *("w", "peri", "omega", "ω", "argument_of_pericentre", "argument_of_perihelion"),
        *("argument_of_periapsis", "argument_periapsis", "argperi", "arg_peri"),
    ),
    "M": ("ma", "M", "mean_anomaly"),
    "tp": ("tp", "t_p", "T", "time_of_perihelion", "time_of_pericentre"),
    "epoch": ("epoch",),
}
_OF_ELEMENTS = {
    **{"a": LENGTH, "q": LENGTH, "tp": TIME, "epoch": TIME},
    **dict.fromkeys(("i", "node", "peri", "M"), ANGLE),
}
ORIENTED = ("e", "i", "node", "peri")  # elements that every orbit needs; other elements may replace each other
_RIVALS = (("mass", "density"), ("radius", "diameter"))  # pairs of quantities that determine each other
_MOST_SHOWN = 12  # largest number of columns that a message lists
_MOST_NOTED = 200  # largest number of columns that a note lists

# further columns of elements
_ORBIT = frozenset(("a", "e", "ecc", "inc", "incl", "om", "node", "peri", "ma", "tp", "epoch", "moid"))
_SPHERICAL = frozenset(("theta", "phi", "lat", "lon", "ra", "dec", "delta", "rdot", "rr"))
_MEANINGS = {  # ambiguous names: their meanings, and columns that suggest one of these meanings
    "r": ("a distance or a colour", _ORBIT | _SPHERICAL | {"g", "b"}),
    "rho": ("a distance", _SPHERICAL),
    "m": ("a mean anomaly or a magnitude", frozenset[str]()),
}
_COEFFICIENTS = "[contact] or a [[material]] gives coefficients"
_ELSEWHERE = {  # why some columns with data of spheres are not used, by plain name
    **dict.fromkeys(("mu", "friction", "frictioncoefficient", "mus", "muk"), _COEFFICIENTS),
    **dict.fromkeys(("restitution", "cor", "coefficientofrestitution"), _COEFFICIENTS),
    **dict.fromkeys((f"quat{axis}" for axis in "wxyzijk"), "a sphere starts without a rotation"),
    **dict.fromkeys((f"q{axis}" for axis in "wxyz"), "a sphere starts without a rotation"),
    **dict.fromkeys(("orientation", "quaternion", "quat"), "a sphere starts without a rotation"),
    **dict.fromkeys((f"{force}{axis}" for force in ("f", "tq", "torque") for axis in "xyz"), "carom computes forces"),
    **dict.fromkeys(("q", "charge"), "there is no force on charges"),
}

ColumnMapping = dict[str, tuple[FileColumn, ...]]  # quantity → one column, three, or two in a plane


def columns_in(table: DataTable, section: BodyData) -> list[FileColumn]:
    """Return the columns of a table, including hidden columns that the scene names."""
    named = [columns for _, columns in section.columns if columns is not None]
    asked = {name for columns in named for name in ((columns,) if isinstance(columns, str) else columns)}
    names = [*table.names, *(name for name in table.hidden if name in asked)]
    return columns_of(names, table.facts, table.paths)


def mapping_of(section: BodyData, columns: Sequence[FileColumn], table: DataTable) -> ColumnMapping:
    """Return the columns of each quantity that has no value in the scene.

    Raises SceneError if a column is missing, if two columns hold the same quantity, or if a vector with an unknown name
    may hold a quantity that would otherwise be 0.
    """
    mapping: ColumnMapping = {}
    called = table.called
    for quantity in QUANTITIES:
        asked = getattr(section.columns, quantity)
        if asked is not None:
            names = (asked,) if isinstance(asked, str) else asked
            mapping[quantity] = tuple(_named(name, columns, table, quantity) for name in names)
        elif not _is_given(section, quantity):
            candidates = _candidates(section, quantity, columns)
            if len(candidates) > 1:
                shown = " and ".join(" ".join(column.name for column in each) for each in candidates[:2])
                quoted = ", ".join(f'"{column.name}"' for column in candidates[0])
                names = f"[{quoted}]" if len(candidates[0]) > 1 else quoted
                raise SceneError(
                    f"{called}: two columns for {quantity}, {shown}; select one: columns = {{ {quantity} = {names} }}"
                )
            if candidates:
                _refuse_doubtful(quantity, candidates[0][0], columns, called)
                mapping[quantity] = candidates[0]
            elif quantity in ("velocity", "angular_velocity"):
                part = _part_of_vector(quantity, columns, len(mapping["position"]) == len("xy"), called)
                mapping |= {quantity: part} if part else {}
        if quantity == "position":
            _refuse_missing(section, mapping, columns, called, ("position",))
    for first, second in _RIVALS:  # the scene must name the column of one of the two
        if first in mapping and second in mapping:
            asked = [quantity for quantity in (first, second) if getattr(section.columns, quantity) is not None]
            if len(asked) != 1:
                names = " and ".join(mapping[each][0].name for each in (first, second))
                raise SceneError(
                    f"{called}: columns for both {first} and {second}, {names}; "
                    f'select one: columns = {{ {first} = "{mapping[first][0].name}" }}'
                )
            del mapping[second if asked == [first] else first]
    _refuse_missing(section, mapping, columns, called, ("radius", "mass"))
    _refuse_lost_vectors(section, mapping, columns, table)
    for quantity, three in mapping.items():
        if len({bool(column.unit or column.odd) for column in three}) > 1:
            names = " and ".join(column.shown for column in three)
            such = f"{printable(three[-1].name)} [{DIMENSIONS[quantity][0].unit}]"
            raise SceneError(
                f"{called}: columns for {quantity}, {names}, of which only some state a unit; write the unit of each "
                f'in columns = {{ {quantity} = [...] }}, such as "{such}"'
            )
    return mapping


def _part_of_vector(quantity: str, columns: Sequence[FileColumn], plane: bool, called: str) -> tuple[FileColumn, ...]:
    """Return the two columns of a vector in a plane; raise SceneError if a vector in space lacks columns."""
    known = {column.plain: column for column in columns}
    for pattern in USUAL_AXES[quantity]:
        axes = [pattern.replace("*", axis) for axis in "xyz"]
        there, missing = ([axis for axis in axes if (axis in known) is wanted] for wanted in (True, False))
        if plane and missing == axes[2:]:
            return tuple(known[axis] for axis in there)
        if there and missing:
            raise SceneError(
                f"{called}: columns for {quantity} are incomplete: {' and '.join(known[axis].name for axis in there)} "
                f"without {' and '.join(missing)}; add the rest, or give {quantity} = [x, y, z] for all bodies"
            )
    return ()


def _refuse_lost_vectors(
    section: BodyData, mapping: ColumnMapping, columns: Sequence[FileColumn], table: DataTable
) -> None:
    """Refuse an unused vector that may be a velocity, if bodies would be at rest without it."""
    plain = {column.plain: column for column in columns}
    used = {column.name for each in mapping.values() for column in each}
    for quantity, beginnings in _LOST.items():
        if quantity in mapping or _is_given(section, quantity):
            continue
        for name, column in plain.items():
            axes = [f"{name[:-1]}{axis}" for axis in "xyz"]
            is_vector = column.name in table.vectors or (name[-1:] == "x" and all(axis in plain for axis in axes))
            if is_vector and name.startswith(beginnings) and column.name not in used:
                names = [column.name] if column.name in table.vectors else [plain[axis].name for axis in axes]
                listed = ", ".join(map(printable, names))
                as_named = f'"{names[0]}"' if len(names) == 1 else str(names).replace("'", '"')
                if name.startswith(("mom", "angmom", "angularmom")):
                    remedy = f"divide it by the {'mass' if quantity == 'velocity' else 'moment of inertia'} in the file"
                else:
                    remedy = f"write columns = {{ {quantity} = {as_named} }} if so"
                raise SceneError(
                    f"{table.called}: {listed} may hold the {quantity.replace('_', ' ')}, which no other column has; "
                    f"{remedy}, or {quantity} = [0, 0, 0] in [[bodies]]"
                )


def with_material(section: BodyData, material: Material, columns: Sequence[FileColumn]) -> BodyData:
    """Return a table with values of its material for quantities that neither the table nor a column states."""

    def is_known(*quantities: str) -> bool:
        return any(
            getattr(section.columns, quantity) is not None
            or _is_given(section, quantity)
            or _candidates(section, quantity, columns)
            for quantity in quantities
        )

    density = material.density if material.density is not None and not is_known("mass", "density") else None
    factor = material.inertia_factor if material.inertia_factor is not None and not is_known("inertia") else None
    given = {"density": density, "inertia_factor": factor}
    return section.model_copy(update={key: value for key, value in given.items() if value is not None})


def unused_columns(
    section: BodyData, mapping: ColumnMapping, columns: Sequence[FileColumn], choosing: Sequence[str] = ()
) -> str:
    """List the columns that are not used for bodies, with reasons where known; empty if there are none.

    The columns ``choosing`` select the rows.
    """
    used = {*choosing, *(column.name for each in mapping.values() for column in each)}
    given = {quantity for quantity in QUANTITIES if _is_given(section, quantity)}
    usual = {
        column.name: "radius" if quantity == "diameter" else quantity
        for quantity in given
        for each in _usual(quantity, columns)
        for column in each
    }
    unused = [column for column in columns if column.name not in used]

    def described(column: FileColumn) -> str:
        why = f"the scene gives the {usual[column.name]}" if column.name in usual else _ELSEWHERE.get(column.plain, "")
        return printable(column.name) + (f" ({why})" if why else "")

    listed = ", ".join(map(described, unused[:_MOST_NOTED]))
    more = len(unused) - _MOST_NOTED
    return f"{listed} and {more} more" if more > 0 else listed


def elements_in(columns: Sequence[FileColumn]) -> dict[str, FileColumn]:
    """Return the columns of the orbital elements that a table has."""
    plain = {column.proper: column for column in reversed(columns)}
    for column in reversed(columns):
        for element, dimension in _OF_ELEMENTS.items():
            other = column.with_suffix(dimension, brief=True)
            if other and other.proper in ELEMENTS[element]:
                plain.setdefault(other.proper, other)
    small = {name.casefold(): column for name, column in plain.items() if not (len(name) == 1 and name.isupper())}
    found = dict[str, FileColumn]()
    for element, usual in ELEMENTS.items():
        exact = [plain[name] for name in usual if name in plain]
        alike = [small[name] for name in usual if name.islower() and name in small]
        if known := [*exact, *(column for column in alike if column not in found.values())]:
            found[element] = known[0]
    return found


def usual_names(names: Sequence[str]) -> int:
    """Return how many of the given names are usual names of columns."""
    columns = columns_of(names, Facts())
    return len({column.name for quantity in QUANTITIES for each in _alike(quantity, columns) for column in each})


def question(called: str, column: FileColumn, quantity: str, others: str) -> SceneError:
    """Return the error for a column whose meaning may not be the usual one."""
    named = f'columns = {{ {quantity} = "{printable(column.name)}" }}'
    return SceneError(
        f"{called}: column {printable(column.name)} may be the {quantity}, or {others}; write {named} if it is the "
        f"{quantity}, or give {quantity} = … for all bodies"
    )


def _refuse_doubtful(quantity: str, column: FileColumn, columns: Sequence[FileColumn], called: str) -> None:
    """Refuse a name with several meanings unless other columns confirm the usual meaning."""
    plain, own = [each.plain for each in columns], column.proper
    others, signs = _MEANINGS.get(column.plain, ("", frozenset[str]()))
    if not others or column.unit:
        return
    place, proper = plain.index(column.plain), {each.proper for each in columns}
    if "m" in plain[max(0, place - 1) : place + 2] and own == "r" and "M" not in proper:  # "m, r", the order in REBOUND
        return
    if beside := [each for each in columns if each.plain in signs]:
        raise question(called, column, quantity, f"{others}, since there is a column {printable(beside[0].name)}")
    if own == "M" and not {"X", "R"} & proper:
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


def _named(name: str, columns: Sequence[FileColumn], table: DataTable, quantity: str) -> FileColumn:
    """Return the column that the scene names, with the unit that the scene adds to the name, if any."""
    asked = column_named(name, table.paths)
    exact = [column for column in columns if column.name == name]
    found = exact or [column for column in columns if column.plain == asked.plain]
    if not found:
        names = [column.name for column in columns]
        known = suggestion(name, names) if len(columns) <= _MOST_SHOWN else _listed(columns)
        raise SceneError(f'{table.called}: there is no column "{name}" for {quantity}; {known}')
    if len(found) > 1:
        raise SceneError(f'{table.called}: {len(found)} columns are called "{name}"; give each column its own name')
    if asked.unit and not exact:
        return replace(found[0], unit=asked.unit, odd="")
    return next(_with_suffix(quantity, found, brief=True), found[0])


def _with_suffix(quantity: str, columns: Sequence[FileColumn], brief: bool) -> Iterator[FileColumn]:
    """Yield the columns whose names end with a unit of a quantity, as "mass_kg" does."""
    dimensions = DIMENSIONS.get(quantity, ())
    if len(dimensions) == 1:
        yield from filter(None, (column.with_suffix(dimensions[0], brief) for column in columns))


def _candidates(section: BodyData, quantity: str, columns: Sequence[FileColumn]) -> list[tuple[FileColumn, ...]]:
    """Return the usual columns of a quantity; none for the inertia if the scene states the radius or the mass."""
    found = _usual(quantity, columns)
    if quantity == "name" and len(found) > 1:
        found = [each for each in found if each[0].plain != "fullname"]
    if quantity != "inertia" or not found:
        return found
    replaced = (("radius", "diameter"), ("mass", "density"))
    stale = any(_is_given(section, of[0]) and any(_usual(each, columns) for each in of) for of in replaced)
    return [] if stale else found


def _usual(quantity: str, columns: Sequence[FileColumn]) -> list[tuple[FileColumn, ...]]:
    """Return the columns that may hold a quantity: single columns and triples, else columns with a unit as a suffix."""
    return _alike(quantity, columns) or _alike(quantity, list(_with_suffix(quantity, columns, brief=False)))


def _alike(quantity: str, columns: Sequence[FileColumn]) -> list[tuple[FileColumn, ...]]:
    plain = [column.plain for column in columns]
    single = [(column,) for column, name in zip(columns, plain, strict=True) if name in USUAL[quantity]]
    threes = []
    for pattern in USUAL_AXES.get(quantity, ()):
        axes = [pattern.replace("*", axis) for axis in "xyz"]
        if all(axis in plain for axis in axes):
            repeated = next((axis for axis in axes if plain.count(axis) > 1), None)
            three = tuple(columns[plain.index(axis)] for axis in axes)
            threes += [three, three] if repeated else [three]
    return single + threes


def _refuse_missing(
    section: BodyData, mapping: ColumnMapping, columns: Sequence[FileColumn], called: str, wanted: Sequence[str]
) -> None:
    """Refuse a table without a position, a radius or a mass."""
    usual = {
        "position": "x, y and z, or position",
        "radius": "radius or r, or diameter",
        "mass": "mass or m, or density",
    }
    for quantity in wanted:
        given = quantity in mapping or _is_given(section, quantity) or dict(_RIVALS).get(quantity) in mapping
        if not given:
            constant = "" if quantity == "position" else f", or give {quantity} = … for all bodies"
            if quantity == "position" and set(ORIENTED) <= set(elements_in(columns)):
                raise SceneError(
                    f'{called}: it has orbital elements; write orbit = {{ central_mass = "1 M_sun" }} to read them'
                )
            plain = {column.plain: column.name for column in columns}
            for pattern in USUAL_AXES["position"] if quantity == "position" else ():
                x, y, z = (plain.get(pattern.replace("*", axis)) for axis in "xyz")
                if x and y and not z:
                    raise SceneError(
                        f"{called}: no column for {pattern.replace('*', 'z')}; write columns = {{ position = "
                        f'["{x}", "{y}"] }} if the bodies are in the plane z = 0'
                    )
            one = '["…", "…", "…"]' if quantity in VECTORS else '"…"'
            raise SceneError(
                f"{called}: no column for {quantity} (usually {usual[quantity]}); {_listed(columns)}; name it with "
                f"columns = {{ {quantity} = {one} }}{constant}"
            )


def _listed(columns: Sequence[FileColumn]) -> str:
    shown = ", ".join(printable(column.name) for column in columns[:_MOST_SHOWN])
    more = f" and {len(columns) - _MOST_SHOWN} more" if len(columns) > _MOST_SHOWN else ""
    return f"its columns are {shown}{more}" if columns else "it has no columns"
