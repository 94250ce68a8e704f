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
from carom.physics.checkpoint import Books, Checkpoint
from carom.physics.contact.contact_checkpoint import ContactCheckpoint, SleepCheckpoint
from carom.physics.diagnostics.energy import Energy
from carom.physics.diagnostics.ledger import Ledger, NamedEnergies
from carom.physics.frame import Frame
from carom.physics.integrators.batch_integrator import EqualSteps, IntegratorCheckpoint, OrbitCheckpoint
from carom.recording.schema.header import LARGEST, Header
from carom.recording.schema.paths import STEP

Values = NDArray[Any] | list[str]
Column = tuple[Values, list[int]]  # the values of all rows, and their number in each row

_ENERGIES = ("translational", "rotational", "gravitational", "field", "integration_error", "scale")
_LEDGER = ("restitution", "friction", "stabilisation")
_DIGEST = "digest"
_NOT_DIGESTED = (_DIGEST, STEP)  # in a clip, the step is a component, too
_BOOKS = TypeAdapter(Books)
_BY_NAME = ("forces", "others")  # energies by name, in JSON an object
_IF_FOUND = ("contact_audit", "dissipation_error", "wrong_work")  # what only some runs measure or find
_BOOKS_BYTES = 1200  # bytes as JSON
_CONTACT_BYTES = 56  # bytes: two indices, the speed, four components of the impulse
_INTEGRATOR = "integrator_"
_INTEGRATOR_ARRAYS = {"position_rest": 3, "velocity_rest": 3, "accepted": 24, "correction": 24}  # numbers per body
_ORBITS = "orbit_"
_ORBIT_ARRAYS = {"order": 1, "near": 1, "position": 3, "velocity": 3}  # numbers per body
_SERIES = len(EqualSteps._fields)
_FULL = 7  # contacts per body in a dense packing, including near ones
_PRESENT = "present"
_OF_BODIES = ("position", "velocity", "acceleration", "orientation", "angular_velocity")


@dataclass(frozen=True, kw_only=True)
class PartialCheckpoint(Checkpoint):
    """The state of a run in which bodies come and go; NaN for the bodies that do not exist. Only these are stored."""

    present: IntArray  # (k,) numbers of the bodies that exist

    @classmethod
    def of(cls, whole: Checkpoint, present: IntArray, **others: Any) -> PartialCheckpoint:
        """Return a checkpoint with a place for each body of the run; ``others`` replace some fields."""
        return cls(**_values_of(whole) | others, present=present)

    @property
    def fingerprint(self) -> int:
        """A fingerprint of the bodies that exist, which equals that of the frame."""
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
    """Spread the state of the bodies that exist over places for all bodies of the run."""
    wide = dict[str, FloatArray]()
    for name in _OF_BODIES:
        values = getattr(found, name)
        if values is not None:
            wide[name] = np.full((bodies, values.shape[1]), np.nan)
            wide[name][present] = values
    return PartialCheckpoint.of(found, present, **wide)


def size(frame: Frame) -> int:
    """Return the bytes of the checkpoint of a frame."""
    memory, carried = frame.memory, frame.integrator
    contacts = 0 if memory is None else len(memory.pairs)
    if memory is not None and memory.sleep is not None:  # sleep adds 4 numbers per body
        contacts += len(memory.sleep.pairs) + 32 * len(frame.position) // _CONTACT_BYTES
    numbers = 0 if carried is None else 1 + sum(getattr(carried, name).size for name in _INTEGRATOR_ARRAYS)
    if carried is not None and carried.orbits is not None:
        numbers += _SERIES + sum(getattr(carried.orbits, name).size for name in _ORBIT_ARRAYS)
    further = len(frame.energy.others) + len(frame.energy.ledger.forces)
    return _size(len(frame.position), frame.angular_velocity is not None, contacts, further) + 8 * numbers


def largest_size(header: Header) -> int:
    """Return the bytes of a checkpoint of densely packed bodies."""
    lasts = header.collides and len(header.forces) > 0
    return _size(header.bodies, header.spins, _FULL * header.bodies if lasts else 0, len(header.forces))


def _size(bodies: int, spins: bool, contacts: int, further: int) -> int:
    scalars = 8 * (4 + len(_ENERGIES) + len(_LEDGER) + further)
    return 8 * bodies * (16 if spins else 9) + _CONTACT_BYTES * contacts + scalars + _BOOKS_BYTES


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
    if len(parts) == 1:  # not copied, since it takes 130 MB for a million bodies
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
    energy, ledger = checkpoint.energy, checkpoint.energy.ledger
    arrays: dict[str, NDArray[Any] | float | None] = {
        "position": checkpoint.position,
        "velocity": checkpoint.velocity,
        "acceleration": checkpoint.acceleration,
        "time": checkpoint.time,
        "previous_dt": checkpoint.previous_dt,
        "orientation": checkpoint.orientation,
        "angular_velocity": checkpoint.angular_velocity,
    }
    arrays |= {f"energy_{name}": energy.term(name) for name in (*_ENERGIES, *dict(energy.others))}
    arrays |= {f"ledger_{name}": ledger.entry(name) for name in (*_LEDGER, *dict(ledger.forces))}
    carried = checkpoint.integrator
    if carried is not None:
        arrays |= {_INTEGRATOR + name: getattr(carried, name) for name in ("last_dt", *_INTEGRATOR_ARRAYS)}
        if carried.orbits is not None:
            arrays |= {_ORBITS + name: getattr(carried.orbits, name) for name in ("series", *_ORBIT_ARRAYS)}
    row = {name: np.asarray(array, dtype=np.float64).ravel() for name, array in arrays.items() if array is not None}
    contacts = {} if checkpoint.contacts is None else _contacts_of(checkpoint.contacts)
    # the books as JSON, without terms that the run does not model or audit
    return {**row, "books": [json.dumps(_plain(checkpoint.books))], **contacts}


def _plain(value: Any) -> Any:
    """Return a value that JSON can hold. `dataclasses.asdict` would copy every number, which takes most of the time."""
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
    """Return the names of the fields of a data class; None if it is not one."""
    return tuple(field.name for field in fields(kind)) if is_dataclass(kind) else None


def _contacts_of(memory: ContactCheckpoint) -> dict[str, Values]:
    # the impulses usually belong to the step's own contacts, whose pairs are then stored only once
    own = np.array_equal(memory.held_pairs, memory.pairs)
    found: dict[str, Values] = {
        "contact_pairs": memory.pairs.ravel().astype(np.uint32),
        "contact_rest_speed": memory.rest_speed,
        "contact_load_speed": memory.load_speed,
        "contact_dt": np.array([memory.dt]),
        "held_pairs": (memory.held_pairs[:0] if own else memory.held_pairs).ravel().astype(np.uint32),
        "held_impulse": memory.impulse[:, :4].ravel(),
        "held_kick": np.array([memory.kick]),
    }
    if memory.impulse.shape[1] > 4:
        found["held_angular"] = memory.impulse[:, 4:].ravel()
    if (sleep := memory.sleep) is not None:
        found |= {"sleep_calm": sleep.calm, "sleep_reference": sleep.reference.ravel()}
        found |= {"sleep_pairs": sleep.pairs.ravel().astype(np.uint32), "sleep_force": sleep.force.ravel()}
    if memory.piston is not None:
        found["piston"] = memory.piston
    return found


def decode(step: int, stored: Mapping[str, NDArray[Any] | list[Any]], bodies: int) -> Checkpoint:
    """Undo `encode` for one row.

    Raises RecordingError if the row is incomplete, has another number of bodies, is not finite, or differs from its
    digest, since a file from a stranger may contain anything.
    """
    try:
        present = stored.get(_PRESENT)
        row = _Row(stored, bodies if present is None else len(present))
        checkpoint = Checkpoint(
            step=step,
            time=row.number("time"),
            previous_dt=row.number("previous_dt"),
            position=row.vectors("position", 3),
            velocity=row.vectors("velocity", 3),
            acceleration=row.vectors("acceleration", 3),
            orientation=row.vectors("orientation", 4) if "orientation" in stored else None,
            angular_velocity=row.vectors("angular_velocity", 3) if "angular_velocity" in stored else None,
            energy=Energy(
                ledger=Ledger(
                    **{name: row.number(f"ledger_{name}") for name in _LEDGER}, forces=row.further("ledger_", _LEDGER)
                ),
                **{name: row.number(f"energy_{name}") for name in _ENERGIES},
                others=row.further("energy_", _ENERGIES),
            ),
            contacts=row.contacts() if "contact_pairs" in stored else None,
            books=row.books(),
            integrator=row.integrator() if _INTEGRATOR + "last_dt" in stored else None,
        )
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
    """One row of stored components, each checked before it is used."""

    def __init__(self, stored: Mapping[str, NDArray[Any] | list[Any]], bodies: int) -> None:
        self._stored = stored
        self._bodies = bodies

    def number(self, name: str) -> float:
        return float(self._finite(name, 1)[0])

    def further(self, prefix: str, known: Sequence[str]) -> NamedEnergies:
        """Return the further components with a prefix, which not every checkpoint has, in alphabetical order."""
        names = sorted(name.removeprefix(prefix) for name in self._stored if name.startswith(prefix))
        return tuple((name, self.number(prefix + name)) for name in names if name not in known)

    def books(self) -> Books:
        """Undo `_plain`."""

        def entries(found: dict[str, Any]) -> dict[str, Any]:
            by_name = {key: found[key] for key in _BY_NAME if isinstance(found.get(key), dict)}
            return found | {key: tuple(value.items()) for key, value in by_name.items()}

        return _BOOKS.validate_python(json.loads(str(self._stored["books"][0]), object_hook=entries))

    def vectors(self, name: str, width: int) -> FloatArray:
        values = self._finite(name, width * self._bodies).reshape(self._bodies, width)
        if np.any(np.abs(values) > LARGEST):
            raise ValueError(f"{name} has numbers too large to be squared")
        return values

    def integrator(self) -> IntegratorCheckpoint:
        orbits = self.orbits() if _ORBITS + "series" in self._stored else None
        bodies = 0 if orbits is not None and len(self._stored[_INTEGRATOR + "accepted"]) == 0 else self._bodies
        found = {
            name: self._finite(_INTEGRATOR + name, numbers * bodies) for name, numbers in _INTEGRATOR_ARRAYS.items()
        }
        return IntegratorCheckpoint(
            self.number(_INTEGRATOR + "last_dt"),
            found["position_rest"].reshape(-1, 3),
            found["velocity_rest"].reshape(-1, 3),
            found["accepted"].reshape(-1, 8),
            found["correction"].reshape(-1, 8),
            orbits,
        )

    def orbits(self) -> OrbitCheckpoint:
        series = EqualSteps(*self._finite(_ORBITS + "series", _SERIES).tolist())
        found = {name: self._finite(_ORBITS + name, numbers * self._bodies) for name, numbers in _ORBIT_ARRAYS.items()}
        if not np.array_equal(np.sort(found["order"]), np.arange(self._bodies)):
            raise ValueError(f"{_ORBITS}order is not an order of the bodies")
        if series.phase not in (0.0, 1.0, 2.0) or series.steps < 0.0 or series.limit not in (0.0, 1.0, 2.0):
            raise ValueError(f"{_ORBITS}series is not a series of equal steps")
        x, v = found["position"].reshape(-1, 3), found["velocity"].reshape(-1, 3)
        return OrbitCheckpoint(series, found["order"], found["near"], x, v)

    def contacts(self) -> ContactCheckpoint:
        pairs = self._pairs("contact_pairs")
        impulse = self._finite("held_impulse")
        held = self._pairs("held_pairs")
        held = held if len(held) else pairs[: len(impulse) // 4]
        if impulse.size != 4 * len(held):
            raise ValueError(f"{impulse.size // 4} impulses for {len(held)} contacts")
        angular = np.empty((len(held), 0))
        if "held_angular" in self._stored:
            angular = self._finite("held_angular", 3 * len(held)).reshape(-1, 3)
        return ContactCheckpoint(
            pairs=pairs,
            rest_speed=self._finite("contact_rest_speed", len(pairs)),
            load_speed=self._finite("contact_load_speed", len(pairs)),
            dt=self.number("contact_dt"),
            held_pairs=held,
            impulse=np.concatenate((impulse.reshape(-1, 4), angular), axis=1),
            kick=self.number("held_kick"),
            sleep=self.sleep() if "sleep_calm" in self._stored else None,
            piston=self._finite("piston", 3) if "piston" in self._stored else None,
        )

    def sleep(self) -> SleepCheckpoint:
        pairs = self._pairs("sleep_pairs")
        force = self._finite("sleep_force", 4 * len(pairs)).reshape(-1, 4)
        return SleepCheckpoint(
            self._finite("sleep_calm", self._bodies), self.vectors("sleep_reference", 3), pairs, force
        )

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
