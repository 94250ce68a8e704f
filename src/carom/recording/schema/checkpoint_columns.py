"""Encodes and decodes checkpoints: float64 states from which a run resumes with the same bits."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass
from functools import cache
from typing import Any

import numpy as np
import xxhash
from numpy.typing import NDArray
from pydantic import TypeAdapter, ValidationError

from carom.arrays import FloatArray, IntArray
from carom.errors import RecordingError
from carom.recording.schema.header import LARGEST, Header
from carom.recording.timelines import STEP
from carom.state.books import Books
from carom.state.checkpoint import Checkpoint, ContactCheckpoint
from carom.state.energies import Energy, Ledger, NamedEnergies
from carom.state.frame import Frame
from carom.state.saved import (
    BODY,
    CONTACT,
    ENCOUNTER,
    HELD,
    RUN,
    Saved,
    all_saved,
    first_saved,
    may_lack,
    saved_fields,
    saved_parts,
)

Values = NDArray[Any] | list[str]
Column = tuple[Values, list[int]]  # the values of all rows, and the number of values in each row

_DIGEST = "digest"
_NOT_DIGESTED = (_DIGEST, STEP)  # in a clip, the step is a component, too
_BOOKS = TypeAdapter(Books)
_BY_NAME = ("forces", "others")  # columns of energies by name, each an object in JSON
_IF_FOUND = ("contact_audit", "dissipation_error", "wrong_work")  # columns that only some runs measure or find
BOOKS_BYTES = 1200  # bytes of the books of a checkpoint, as JSON
_FULL = 7  # contacts per body in a dense packing, including near contacts
_PRESENT = "present"
_OF_BODIES = tuple(name for name, (first, *_) in saved_fields(Checkpoint).items() if first.per == BODY)


@dataclass(frozen=True, kw_only=True)
class PartialCheckpoint(Checkpoint):
    """The state of a run in which bodies come and go; NaN for missing bodies, which are not stored."""

    present: IntArray  # (k,) numbers of the bodies that exist

    @classmethod
    def of(cls, whole: Checkpoint, present: IntArray, **others: Any) -> PartialCheckpoint:
        """Return a checkpoint with a place for each body of the run; ``others`` replace some fields."""
        return cls(**_values_of(whole) | others, present=present)

    @property
    def fingerprint(self) -> int:
        """A fingerprint of the bodies that exist, equal to the fingerprint of the frame."""
        return self.among_present().fingerprint

    def among_present(self) -> Checkpoint:
        """Return the state of the bodies that exist."""
        values = _values_of(self)
        for name in _OF_BODIES:
            values[name] = None if values[name] is None else values[name][self.present]
        return Checkpoint(**values)


def _values_of(checkpoint: Checkpoint) -> dict[str, Any]:
    return {field.name: getattr(checkpoint, field.name) for field in fields(Checkpoint)}


def spread(found: Checkpoint, present: IntArray, bodies: int) -> PartialCheckpoint:
    """Spread the state of the bodies that exist over the places of all bodies of the run."""
    wide = dict[str, FloatArray]()
    for name in _OF_BODIES:
        values = getattr(found, name)
        if values is not None:
            wide[name] = np.full((bodies, values.shape[1]), np.nan)
            wide[name][present] = values
    return PartialCheckpoint.of(found, present, **wide)


def size(frame: Frame) -> int:
    """Return the size of a frame's checkpoint, in bytes."""
    return _size_of(frame.checkpoint) + BOOKS_BYTES


def _size_of(part: Any) -> int:
    """Return the size (bytes) of an object with saved fields, and of its parts; repeated fields are not stored."""
    kind: Any = type(part)  # Any, since mypy does not accept a class as the key of a cache
    numbers, parts = _counted(kind)
    total = sum(_size_of(each) for name in parts if (each := getattr(part, name)) is not None)
    for name, each, is_named in numbers:
        value = getattr(part, name)
        if isinstance(value, np.ndarray):
            total += each * value.size
        elif value is not None:
            total += each * (len(value) if is_named else np.size(value))
    return total


@cache
def _counted(owner: type) -> tuple[list[tuple[str, int, bool]], list[str]]:
    """Return name, bytes per number and whether it has energies by name, for each field of a class; and its parts."""
    stored = ((name, first) for name, (first, *_) in saved_fields(owner).items() if not first.repeats)
    numbers = [(name, first.bytes // (first.width * first.rows), first.is_named) for name, first in stored]
    return numbers, list(saved_parts(owner))


def largest_size(header: Header) -> int:
    """Return the size (bytes) of a checkpoint of densely packed bodies."""
    contacts = _FULL * header.bodies if header.collides and header.forces else 0
    return _largest_size(header.bodies, contacts, len(header.forces))


def _largest_size(bodies: int, contacts: int, forces: int) -> int:
    count = {BODY: bodies, CONTACT: contacts, HELD: contacts}
    table = (
        first for owner in (Checkpoint, ContactCheckpoint, Energy, Ledger) for first, *_ in saved_fields(owner).values()
    )
    return sum(each.bytes * count.get(each.per, 1) for each in table if not each.repeats) + 8 * forces + BOOKS_BYTES


def unit_of(component: str) -> str:
    """Return the SI unit of a component; empty for pure numbers and texts."""
    named = [each for each in all_saved(Checkpoint) if component.startswith(each.name if each.is_named else component)]
    return next((each.unit for each in named if each.is_named or each.name == component), "")


def encode(checkpoints: Sequence[Checkpoint]) -> dict[str, Column]:
    """Flatten checkpoints into one column per component, row after row, and a digest of each row."""
    rows = [_row_of(checkpoint) for checkpoint in checkpoints]
    for row in rows:
        row[_DIGEST] = np.array([_digest(row)], dtype=np.uint64)
    names = dict.fromkeys(name for row in rows for name in row)
    return {name: _column([row[name] for row in rows if name in row]) for name in names}


def _column(parts: Sequence[Values]) -> Column:
    """Join the values of a component in all rows."""
    each = [len(part) for part in parts]
    if len(parts) == 1:  # return no copy, which would take 130 MB for a million bodies
        return parts[0], each
    texts = [text for part in parts if isinstance(part, list) for text in part]
    return (texts, each) if texts else (np.concatenate(parts), each)


def _digest(row: Mapping[str, Values]) -> int:
    """Return a digest (64 bits) of all components of a row, in the order of their names."""
    digest = xxhash.xxh64()
    for name in sorted(row):
        values = row[name]
        digest.update(name.encode())
        digest.update("".join(values).encode() if isinstance(values, list) else np.ascontiguousarray(values).data)
    return digest.intdigest()


def _row_of(checkpoint: Checkpoint) -> dict[str, Values]:
    """Return the components of a checkpoint."""
    if isinstance(checkpoint, PartialCheckpoint):
        return {**_row_of(checkpoint.among_present()), _PRESENT: checkpoint.present.astype(np.uint32)}
    # the books as JSON, without terms that the run neither models nor audits
    return {**_components_of(checkpoint), "books": [json.dumps(_plain(checkpoint.books))]}


def _components_of(part: Any) -> dict[str, Values]:
    """Return the components of an object with saved fields, and of its parts."""
    row = dict[str, Values]()
    for name, components in saved_fields(type(part)).items():
        value, first = getattr(part, name), components[0]
        if value is None:
            continue
        if first.is_named:
            row |= {first.name + term: np.array([energy]) for term, energy in value}
            continue
        if first.repeats and np.array_equal(value, getattr(part, first.repeats)):
            value = value[:0]
        array = np.asarray(value, dtype=np.uint32 if first.is_pairs else np.float64)
        begin = 0
        for each in components:
            columns = array if len(components) == 1 else array[:, begin : begin + each.width]
            begin += each.width
            if columns.shape[-1:] != (0,) or each is first:
                row[each.name] = columns.ravel()
    for name in saved_parts(type(part)):
        if (inner := getattr(part, name)) is not None:
            row |= _components_of(inner)
    return row


def _plain(value: Any) -> Any:
    """Return a value that JSON can represent. `dataclasses.asdict` would copy every number, which takes much longer."""
    names = _fields_of(value.__class__)
    if names is None:
        return [_plain(entry) for entry in value] if isinstance(value, tuple) else value
    found = {name: _plain(getattr(value, name)) for name in names}
    for name in (*_BY_NAME, *_IF_FOUND):
        if name in found and not found[name]:
            del found[name]
    return found | {name: dict(found[name]) for name in _BY_NAME if name in found}


@cache
def _fields_of(kind: type) -> tuple[str, ...] | None:
    """Return the names of the fields of a data class; None if it is not a data class."""
    return tuple(field.name for field in fields(kind)) if is_dataclass(kind) else None


def decode(step: int, stored: Mapping[str, NDArray[Any] | list[Any]], bodies: int) -> Checkpoint:
    """Undo `encode` for one row.

    Raises RecordingError if the row is incomplete, has another number of bodies, is not finite, or differs from its
    digest, since a stranger's file may contain anything.
    """
    try:
        present = stored.get(_PRESENT)
        row = _Row(stored, bodies if present is None else len(present))
        checkpoint: Checkpoint = row.part(Checkpoint, step=step, books=row.books())
        digested = {name: values for name, values in stored.items() if name not in _NOT_DIGESTED}
        if [int(value) for value in stored[_DIGEST]] != [_digest(digested)]:
            raise ValueError("it does not match its digest")
        if present is None:
            return checkpoint
        numbers = np.asarray(present, dtype=np.int64)
        if len(np.unique(numbers)) < len(numbers) or numbers.max(initial=-1) >= bodies:
            raise ValueError(f"{_PRESENT} names bodies that do not exist")
        return spread(checkpoint, numbers, bodies)
    except (KeyError, IndexError, TypeError, ValueError, OverflowError, RecursionError, ValidationError) as error:
        reason = "its sums are inconsistent" if isinstance(error, ValidationError) else str(error)
        raise RecordingError(f"the checkpoint at step {step} is damaged: {reason}") from error


class _Row:
    """One row of stored components; each component is checked before it is used."""

    def __init__(self, stored: Mapping[str, NDArray[Any] | list[Any]], bodies: int) -> None:
        self._stored = stored
        self._bodies = bodies

    def part(self, owner: type[Any], **others: Any) -> Any:
        """Return an object with saved fields, and with ``others``."""
        found, counts = dict[str, Any](others), {BODY: self._bodies}
        repeated = dict[str, Saved]()
        for name, components in saved_fields(owner).items():
            first = components[0]
            if first.is_named:
                found[name] = self._named(owner, first.name)
            elif first.name not in self._stored and name in may_lack(owner):
                found[name] = None
            elif first.repeats and not len(self._stored[first.name]):
                repeated[name] = first
            else:
                columns = [
                    self._values(each, counts) for each in components if each is first or each.name in self._stored
                ]
                found[name] = columns[0] if len(columns) == 1 else np.concatenate(columns, axis=1)
        for name, each in repeated.items():
            found[name] = found[each.repeats][: counts.get(each.per, 0)]
            if len(found[name]) < counts.get(each.per, 0):
                raise ValueError(f"{each.name} has fewer rows than there are for each {each.per}")
        for name, part in saved_parts(owner).items():
            found[name] = self.part(part) if first_saved(part) in self._stored else None
        made = owner(**found)
        if hasattr(made, "check"):
            made.check()
        return made

    def _named(self, owner: type[Any], prefix: str) -> NamedEnergies:
        """Return the energies whose components begin with a prefix and are no other field, in alphabetical order."""
        known = {each.name for components in saved_fields(owner).values() for each in components}
        names = sorted(name for name in self._stored if name.startswith(prefix) and name not in known)
        return tuple((name.removeprefix(prefix), float(self._finite(name, 1)[0])) for name in names)

    def _values(self, saved: Saved, counts: dict[str, int]) -> Any:
        """Return the number or the array of a component; ``counts`` are the known numbers of rows, by kind."""
        name, width = saved.name, saved.width
        if saved.is_pairs:
            pairs = self._pairs(name)
            counts.setdefault(saved.per, len(pairs))
            return pairs
        if saved.per == RUN:
            values = self._finite(name, width)
            return float(values[0]) if width == 1 else values
        count = np.asarray(self._stored[name]).size // (width * saved.rows)
        if saved.per == ENCOUNTER and count:
            count = self._bodies
        values = self._finite(name, width * saved.rows * counts.setdefault(saved.per, count))
        if saved.is_squared and np.any(np.abs(values) > LARGEST):
            raise ValueError(f"{name} has numbers too large to be squared")
        return values if width == 1 else values.reshape(-1, width)

    def books(self) -> Books:
        """Undo `_plain`."""

        def entries(found: dict[str, Any]) -> dict[str, Any]:
            by_name = {key: found[key] for key in _BY_NAME if isinstance(found.get(key), dict)}
            return found | {key: tuple(value.items()) for key, value in by_name.items()}

        return _BOOKS.validate_python(json.loads(str(self._stored["books"][0]), object_hook=entries))

    def _pairs(self, name: str) -> IntArray:
        pairs = np.ascontiguousarray(np.asarray(self._stored[name], dtype=np.int64).reshape(-1, 2))
        keys = (pairs[:, 0] << 32) + pairs[:, 1]
        if np.any((pairs[:, 0] >= self._bodies) | (pairs[:, 0] >= pairs[:, 1]) | (pairs[:, 0] < 0)):
            raise ValueError(f"{name} has contacts of bodies that do not exist")
        if np.any(np.diff(keys) <= 0):
            raise ValueError(f"{name} is not in order")
        return pairs

    def _finite(self, name: str, count: int | None = None) -> FloatArray:
        values = np.asarray(self._stored[name], dtype=np.float64)
        if count is not None and values.size != count:
            raise ValueError(f"{name} has {values.size} values instead of {count}")
        if not np.isfinite(values).all():
            raise ValueError(f"{name} is not finite")
        return values
