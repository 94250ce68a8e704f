"""Encodes and decodes checkpoints: the float64 state from which a run can be resumed bit for bit."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np
import xxhash
from numpy.typing import NDArray
from pydantic import TypeAdapter, ValidationError

from carom.physics.checkpoint import Books, Checkpoint
from carom.physics.contact.checkpoint import ContactCheckpoint
from carom.physics.diagnostics.energy import Energy
from carom.physics.diagnostics.ledger import Ledger, NamedEnergies
from carom.physics.frame import Frame
from carom.physics.integrators.checkpoint import IntegratorCheckpoint, OrbitCheckpoint
from carom.recording.errors import RecordingError
from carom.recording.schema.header import Header
from carom.recording.schema.timelines import STEP
from carom.scene.forces import FORCES

Column = tuple[NDArray[np.generic] | list[str], list[int]]  # values of all rows, and how many each row has

_ENERGIES = ("translational", "rotational", "gravitational", "field", "integration_error", "scale")
_LEDGER = ("restitution", "friction", "stabilisation")
_LOSSES = tuple(kind.loss for kind in FORCES if kind.loss)
_POTENTIALS = tuple(kind.potential for kind in FORCES if kind.potential and kind.potential not in _ENERGIES)
_DIGEST = "digest"
_NOT_DIGESTED = (_DIGEST, STEP)  # in a clip the step is a component, too
_LARGEST = 1e150  # of a coordinate or a speed, whose squares are computed with
_BOOKS = TypeAdapter(Books)
_BY_NAME = ("forces", "others")  # energies by name, which are objects in JSON
_IF_ASKED = ("contact_audit",)  # extremes that only some runs look at
_BOOKS_BYTES = 1200  # as JSON
_CONTACT_BYTES = 56  # two indices, the speed, an impulse of four
_INTEGRATOR = "integrator_"
_INTEGRATOR_ARRAYS = {"position_rest": 3, "velocity_rest": 3, "accepted": 24, "correction": 24}  # numbers of a body
_ORBITS = "orbit_"
_ORBIT_ARRAYS = {"order": 1, "near": 1, "position": 3, "velocity": 3}  # numbers of a body
_SERIES = 5
_FULL = 7  # contacts per body in a dense packing, near ones included


def size(frame: Frame) -> int:
    """Bytes of the checkpoint of a frame."""
    contacts = 0 if frame.memory is None else len(frame.memory.pairs)
    further = len(frame.energy.others) + len(frame.energy.ledger.forces)
    return _size(len(frame.position), frame.angular_velocity is not None, contacts, further) + _carried_size(frame)


def _carried_size(frame: Frame) -> int:
    if frame.integrator is None:
        return 0
    numbers: int = 1 + sum(getattr(frame.integrator, name).size for name in _INTEGRATOR_ARRAYS)
    if frame.integrator.orbits is not None:
        numbers += _SERIES + sum(getattr(frame.integrator.orbits, name).size for name in _ORBIT_ARRAYS)
    return 8 * numbers


def largest_size(header: Header) -> int:
    """Bytes of a checkpoint of densely packed bodies."""
    lasts = header.collides and len(header.forces) > 0
    return _size(header.bodies, header.spins, _FULL * header.bodies if lasts else 0, len(header.forces))


def _size(bodies: int, spins: bool, contacts: int, further: int) -> int:
    scalars = 8 * (4 + len(_ENERGIES) + len(_LEDGER) + further)
    return 8 * bodies * (16 if spins else 9) + _CONTACT_BYTES * contacts + scalars + _BOOKS_BYTES


def encode(checkpoints: Sequence[Checkpoint]) -> dict[str, Column]:
    """Flatten checkpoints into one column per component, row after row; each row has a digest of the others."""
    digests = [_digest({name: values for name, (values, _) in _encoded([one]).items()}) for one in checkpoints]
    return _encoded(checkpoints) | {_DIGEST: (np.array(digests, dtype=np.uint64), [1] * len(digests))}


def _digest(row: Mapping[str, NDArray[Any] | list[Any]]) -> int:
    """Return 64 bits of all components of a row, by the order of their names."""
    digest = xxhash.xxh64()
    for name in sorted(row):
        values = row[name]
        digest.update(name.encode())
        digest.update("".join(values).encode() if isinstance(values, list) else np.ascontiguousarray(values).tobytes())
    return digest.intdigest()


def _encoded(checkpoints: Sequence[Checkpoint]) -> dict[str, Column]:
    columns = {
        "position": _flat([c.position for c in checkpoints]),
        "velocity": _flat([c.velocity for c in checkpoints]),
        "acceleration": _flat([c.acceleration for c in checkpoints]),
        "time": _each([c.time for c in checkpoints]),
        "previous_dt": _each([c.previous_dt for c in checkpoints]),
    }
    for name in ("orientation", "angular_velocity"):
        arrays = [array for c in checkpoints if (array := getattr(c, name)) is not None]
        if arrays:
            columns[name] = _flat(arrays)
    first = checkpoints[0].energy
    for name in (*_ENERGIES, *dict(first.others)):
        columns[f"energy_{name}"] = _each([c.energy.term(name) for c in checkpoints])
    for name in (*_LEDGER, *dict(first.ledger.forces)):
        columns[f"ledger_{name}"] = _each([c.energy.ledger.entry(name) for c in checkpoints])
    columns["books"] = [_books(c.books) for c in checkpoints], [1] * len(checkpoints)
    carried = [c.integrator for c in checkpoints if c.integrator is not None]
    if carried:
        columns[_INTEGRATOR + "last_dt"] = _each([memory.last_dt for memory in carried])
        for name in _INTEGRATOR_ARRAYS:
            columns[_INTEGRATOR + name] = _flat([getattr(memory, name) for memory in carried])
        columns |= _encode_orbits([memory.orbits for memory in carried if memory.orbits is not None])
    memories = [c.contacts for c in checkpoints if c.contacts is not None]
    return columns | _encode_contacts(memories) if memories else columns


def _encode_orbits(orbits: Sequence[OrbitCheckpoint]) -> dict[str, Column]:
    if not orbits:
        return {}
    return {_ORBITS + name: _flat([getattr(one, name) for one in orbits]) for name in ("series", *_ORBIT_ARRAYS)}


def _books(books: Books) -> str:
    """Return the books as JSON; what a run does not model or look at leaves no byte."""

    def entries(items: list[tuple[str, Any]]) -> dict[str, Any]:
        kept = (item for item in items if item[1] or item[0] not in (*_BY_NAME, *_IF_ASKED))
        return {key: dict(value) if key in _BY_NAME else value for key, value in kept}

    return json.dumps(asdict(books, dict_factory=entries))


def _books_of(text: str) -> Books:
    """Undo `_books`."""

    def entries(found: dict[str, Any]) -> dict[str, Any]:
        by_name = {key: found[key] for key in _BY_NAME if isinstance(found.get(key), dict)}
        return {**found, **{key: tuple(value.items()) for key, value in by_name.items()}}

    return _BOOKS.validate_python(json.loads(text, object_hook=entries))


def _encode_contacts(memories: Sequence[ContactCheckpoint]) -> dict[str, Column]:
    # mostly the impulses are those of the step's own contacts: their pairs are written once
    own = [np.array_equal(memory.held_pairs, memory.pairs) for memory in memories]
    nobody = np.empty((0, 2), dtype=np.int64)
    return {
        "contact_pairs": _flat([memory.pairs.astype(np.uint32) for memory in memories]),
        "contact_rest_speed": _flat([memory.rest_speed for memory in memories]),
        "contact_dt": _each([memory.dt for memory in memories]),
        "held_pairs": _flat(
            [(nobody if same else m.held_pairs).astype(np.uint32) for m, same in zip(memories, own, strict=True)]
        ),
        "held_impulse": _flat([memory.impulse for memory in memories]),
        "held_kick": _each([memory.kick for memory in memories]),
    }


def _flat(rows: Sequence[NDArray[Any]]) -> Column:
    return np.concatenate([row.ravel() for row in rows]), [row.size for row in rows]


def _each(values: Sequence[float]) -> Column:
    return np.array(values, dtype=np.float64), [1] * len(values)


def decode(step: int, stored: Mapping[str, NDArray[Any] | list[Any]], bodies: int) -> Checkpoint:
    """Undo :func:`encode` for one row.

    Raises
    ------
    RecordingError
        If the row is not whole, not of so many bodies, not finite, or not what its digest was made of: a file from a
        stranger may hold anything. Recordings of before there were digests are taken as they are.
    """
    try:
        row = _Row(stored, bodies)
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
                    **{name: row.number(f"ledger_{name}") for name in _LEDGER}, forces=row.further("ledger_", _LOSSES)
                ),
                **{name: row.number(f"energy_{name}") for name in _ENERGIES},
                others=row.further("energy_", _POTENTIALS),
            ),
            contacts=row.contacts() if "contact_pairs" in stored else None,
            books=_books_of(row.text("books")),
            integrator=row.integrator() if _INTEGRATOR + "last_dt" in stored else None,
        )
        if _DIGEST in stored:
            digested = {name: values for name, values in stored.items() if name not in _NOT_DIGESTED}
            if [int(value) for value in stored[_DIGEST]] != [_digest(digested)]:
                raise ValueError("it is not what its digest was made of")
        return checkpoint
    except (KeyError, IndexError, TypeError, ValueError, OverflowError, RecursionError, ValidationError) as error:
        reason = "its books do not add up" if isinstance(error, ValidationError) else str(error)
        raise RecordingError(f"the checkpoint at step {step} is damaged: {reason}") from error


class _Row:
    """One row of stored components, looked at with suspicion."""

    def __init__(self, stored: Mapping[str, NDArray[Any] | list[Any]], bodies: int) -> None:
        self._stored = stored
        self._bodies = bodies

    def number(self, name: str) -> float:
        return float(self._finite(name, 1)[0])

    def further(self, prefix: str, names: Sequence[str]) -> NamedEnergies:
        return tuple((name, self.number(prefix + name)) for name in names if prefix + name in self._stored)

    def text(self, name: str) -> str:
        if name not in self._stored:
            raise ValueError(f"it has no {name}: it was recorded by a version of carom that could not resume from it")
        return str(self._stored[name][0])

    def vectors(self, name: str, width: int) -> NDArray[np.float64]:
        values = self._finite(name, width * self._bodies).reshape(self._bodies, width)
        if np.any(np.abs(values) > _LARGEST):
            raise ValueError(f"{name} has numbers that cannot be squared")
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
        series = self._finite(_ORBITS + "series", _SERIES)
        found = {name: self._finite(_ORBITS + name, numbers * self._bodies) for name, numbers in _ORBIT_ARRAYS.items()}
        if not np.array_equal(np.sort(found["order"]), np.arange(self._bodies)):
            raise ValueError(f"{_ORBITS}order is not an order of the bodies")
        if series[0] not in (0.0, 1.0, 2.0) or series[2] < 0.0 or series[4] not in (0.0, 1.0, 2.0):
            raise ValueError(f"{_ORBITS}series is none of equal steps")
        x, v = found["position"].reshape(-1, 3), found["velocity"].reshape(-1, 3)
        return OrbitCheckpoint(series, found["order"], found["near"], x, v)

    def contacts(self) -> ContactCheckpoint:
        pairs = self._pairs("contact_pairs")
        impulse = self._finite("held_impulse")
        held = self._pairs("held_pairs")
        held = held if len(held) else pairs[: len(impulse) // 4]
        if impulse.size != 4 * len(held):
            raise ValueError(f"{impulse.size // 4} impulses of {len(held)} contacts")
        return ContactCheckpoint(
            pairs=pairs,
            rest_speed=self._finite("contact_rest_speed", len(pairs)),
            dt=self.number("contact_dt"),
            held_pairs=held,
            impulse=impulse.reshape(-1, 4),
            kick=self.number("held_kick"),
        )

    def _pairs(self, name: str) -> NDArray[np.int64]:
        pairs = np.ascontiguousarray(np.asarray(self._stored[name], dtype=np.int64).reshape(-1, 2))
        keys = (pairs[:, 0] << 32) + pairs[:, 1]
        if np.any((pairs[:, 0] >= self._bodies) | (pairs[:, 0] >= pairs[:, 1]) | (pairs[:, 0] < 0)):
            raise ValueError(f"{name} has contacts of bodies that are not there")
        if np.any(np.diff(keys) <= 0):
            raise ValueError(f"{name} is not in order")
        return pairs

    def _finite(self, name: str, count: int | None = None) -> NDArray[np.float64]:
        values = np.array(self._stored[name], dtype=np.float64)
        if count is not None and values.size != count:
            raise ValueError(f"{name} has {values.size} values instead of {count}")
        if not np.isfinite(values).all():
            raise ValueError(f"{name} is not finite")
        return values
