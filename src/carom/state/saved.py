"""The table of a state's fields in checkpoints; each row is written beside the field that it describes.

If a class belongs to `Checkpoint`, its field ``calm: Annotated[FloatArray, Saved("sleep_calm", "s", BODY)]`` is
encoded, decoded, validated, digested and counted by this row (`recording/schema/checkpoint_columns.py`).
"""

from __future__ import annotations

from collections.abc import Hashable, Iterator
from dataclasses import dataclass
from functools import cache
from types import NoneType
from typing import Any, cast, get_args, get_type_hints

# objects for which a field has rows; an `ENCOUNTER` is a body in a close encounter
RUN, BODY, ENCOUNTER, CONTACT, HELD, SLEEPING = "run", "body", "encounter", "contact", "held", "sleeping"
INLET, OUTLET, PISTON = "inlet", "outlet", "piston"


@dataclass(frozen=True, slots=True)
class Saved:
    """One component of a checkpoint. A field with two components has columns of both; the second may be absent."""

    name: str  # name of the component; for energies by name, the prefix of the components' names
    unit: str = ""  # SI unit; empty for pure numbers
    per: str = RUN
    width: int = 1  # number of values in a row
    rows: int = 1  # number of rows for each object of the kind `per`
    is_pairs: bool = False  # whether a row names the two ends of a contact, in ascending order
    is_squared: bool = False  # whether steps square the numbers, so that they need a bound
    is_named: bool = False  # whether the field has energies by name, with a component for each energy
    repeats: str = ""  # name of a field that usually has equal values; if equal, this field is stored without rows

    @property
    def bytes(self) -> int:
        """Bytes of the rows for each object of the kind `per`; the numbers of ends have 32 bits."""
        return (4 if self.is_pairs else 8) * self.width * self.rows


def saved_fields(owner: Any) -> dict[str, tuple[Saved, ...]]:
    """Return the components of each saved field of a class, by the name of the field."""
    return _table(owner)[0]


def saved_parts(owner: Any) -> dict[str, type[Any]]:
    """Return the fields of a class whose types have saved fields themselves, with these types; a field may be None."""
    return _table(owner)[1]


def may_lack(owner: Any) -> set[str]:
    """Return the names of the fields that may be None."""
    return _table(owner)[2]


def first_saved(owner: Any) -> str:
    """Return the name of a component that a checkpoint has if, and only if, it has the part ``owner``."""
    return next(iter(saved_fields(owner).values()))[0].name


def all_saved(owner: Any) -> Iterator[Saved]:
    """Yield all components of a class and of its parts."""
    for components in saved_fields(owner).values():
        yield from components
    for part in saved_parts(owner).values():
        yield from all_saved(part)


@cache
def _table(owner: Hashable) -> tuple[dict[str, tuple[Saved, ...]], dict[str, type[Any]], set[str]]:
    components, parts, optional = dict[str, tuple[Saved, ...]](), dict[str, type[Any]](), set[str]()
    for name, hint in get_type_hints(cast(type, owner), include_extras=True).items():
        found = tuple(each for each in get_args(hint) if isinstance(each, Saved))
        values = get_args(get_args(hint)[0] if found else hint)  # arguments of a union
        kind: Any = next((each for each in values if each is not NoneType), hint)
        if found:
            components[name] = found
        elif hasattr(kind, "__dataclass_fields__") and saved_fields(kind):
            parts[name] = kind
        if NoneType in values:
            optional.add(name)
    return components, parts, optional
