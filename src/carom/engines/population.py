"""`Population`: numbers the bodies of another engine's run in which bodies come and go.

A recording numbers all bodies that ever existed. A frame has a place for each body; a body that does not exist has the
position NaN, which is not drawn. Frames are computed for the present bodies, and then spread over the places of all
bodies.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from carom.arrays import BoolArray, FloatArray, IntArray, Records
from carom.engines.source import MASSLESS, SPHERE, Model, Setup, State, array_of, flags_of, text_from
from carom.errors import RecordingError
from carom.recording.write.partial_frames import PartialFrame
from carom.scene.wording import Names, SomeNames
from carom.state.frame import Frame, empty_graph

FIRST_PLANE = 1 << 40  # number of the first plane while the number of bodies is not known yet


@dataclass(frozen=True, slots=True)
class Present:
    """The bodies that exist at some time."""

    numbers: IntArray  # (k,) numbers of these bodies in the recording
    setup: Setup  # setup of these bodies
    bodies: int  # number of bodies that have existed so far
    names: Names  # names of all bodies so far, and of planes with numbers from `FIRST_PLANE` on

    @property
    def ends(self) -> IntArray:
        """Numbers of the ends of a frame's contacts, (k + p,): the bodies that exist, then the planes."""
        return np.concatenate((self.numbers, self.bodies + np.arange(len(self.setup.planes))))

    @property
    def lasting_ends(self) -> IntArray:
        """Numbers of the ends as in `ends`, but the numbers of planes do not change when bodies come."""
        return np.concatenate((self.numbers, FIRST_PLANE + np.arange(len(self.setup.planes))))


class Population:
    """Numbers the bodies of states by their ids.

    If the mass or radius of a body changes, as in a merger, this body ends and another begins. ``setup`` belongs to the
    first state, and was made from the model; ``ids``, (n,), are the ids of its bodies.
    """

    def __init__(self, setup: Setup, model: Model, ids: IntArray) -> None:
        n = len(setup)
        self.whole = setup  # setup of all bodies that have existed so far
        self._known = dict(enumerate(setup.names))  # names by number
        self._names = Names(SomeNames("body", FIRST_PLANE, self._known), setup.planes.name)
        self.present = Present(np.arange(n), setup, n, self._names)
        self._given = np.stack([np.broadcast_to(each, n) for each in (model.mass, model.radius)], axis=1).astype(float)
        self._ids = ids
        self._bodies_of_id = dict.fromkeys(ids.tolist(), 1)  # number of bodies so far with each id

    def find(self, state: State) -> Present:
        """Return the bodies of a state: the same object as before if no body came or went; or raise RecordingError."""
        engine, known = self.whole.engine, self.present
        if state.ids is None:
            raise RecordingError(f"{engine}: the state has no ids, though the first state had some")
        ids = ids_of(engine, state.ids, len(state.position))
        sizes = np.full((len(ids), 2), np.nan)  # mass in kg and radius in m; NaN if not given
        for column, name in enumerate(("mass", "radius")):
            if (values := getattr(state, name)) is not None:
                sizes[:, column] = array_of(engine, name, values, (len(ids),))
                if len(ids) and sizes[:, column].min() < 0.0:
                    raise RecordingError(f"{engine}: {name}[{sizes[:, column].argmin()}] is negative")
        if np.array_equal(ids, self._ids) and np.all(_same(sizes, self._given[known.numbers])):
            return known
        numbers = self._number(state, ids, sizes)
        whole, self._ids = self.whole, ids
        setup = replace(whole, **{name: getattr(whole, name)[numbers] for name in _COLUMNS})
        setup = replace(setup, names=[whole.names[number] for number in numbers])
        self.present = Present(numbers, setup, len(whole), self._names)
        return self.present

    def _number(self, state: State, ids: IntArray, sizes: FloatArray) -> IntArray:
        """Return the numbers of the bodies in a state; new bodies are added."""
        whole = self.whole
        before = dict(zip(self._ids.tolist(), self.present.numbers.tolist(), strict=True))
        numbers = np.array([before.get(identity, -1) for identity in ids.tolist()], dtype=np.int64)
        numbers[~np.all(_same(sizes, self._given[numbers]), axis=1)] = -1
        new = np.flatnonzero(numbers < 0)
        unknown = new[np.isnan(sizes[new]).any(axis=1)]
        if len(unknown):
            new_body = f"the body with the id {ids[unknown[0]]} is new"
            raise RecordingError(f"{whole.engine}: {new_body}; give its mass and its radius")
        numbers[new] = len(whole) + np.arange(len(new))
        names = list(whole.names)
        for row in new.tolist():
            identity = int(ids[row])
            count = self._bodies_of_id[identity] = self._bodies_of_id.get(identity, 0) + 1
            name = ("" if state.names is None else text_from(state.names[row])) or f"body {len(names)}"
            if count > 1 and identity in before:
                name = f"{whole.names[before[identity]].partition(_AGAIN)[0]}{_AGAIN}{count})"
            names.append(name)
        mass, radius = sizes[new].T
        heavy = np.where(mass > 0.0, mass, MASSLESS * whole.mass.max())
        drawn = np.where(radius > 0.0, radius, whole.radius.min())
        added = {
            "mass": heavy,
            "radius": drawn,
            "inertia": np.maximum(SPHERE * heavy * drawn**2, np.finfo(np.float64).tiny),
            "fixed": flags_of(whole.engine, "fixed", state.fixed, len(ids), False)[new],
            "judged": flags_of(whole.engine, "judged", state.judged, len(ids), True)[new],
            "touches": radius > 0.0,
        }
        joined: dict[str, Any] = {name: np.concatenate((getattr(whole, name), each)) for name, each in added.items()}
        self.whole = replace(whole, **joined, names=names)
        self._known.update((number, names[number]) for number in range(len(whole), len(names)))
        self._given = np.concatenate((self._given, sizes[new]))
        return numbers


_COLUMNS = ("mass", "radius", "inertia", "fixed", "judged", "touches")  # arrays of a setup with one value for each body
_AGAIN = " ("  # text before the number in the name of a body that reuses the id of an earlier body


def ids_of(engine: str, ids: Any, count: int) -> IntArray:
    """Check and return the ids of a state, (count,), which must differ."""
    found = np.asarray(ids)
    if found.shape != (count,) or (count and not np.issubdtype(found.dtype, np.integer)):
        raise RecordingError(f"{engine}: ids must be {count} whole numbers, one for each body")
    unique, counts = np.unique(found, return_counts=True)
    if len(unique) < count:
        raise RecordingError(f"{engine}: the id {unique[np.argmax(counts)]} occurs twice")
    return found.astype(np.int64)


def _same(sizes: FloatArray, known: FloatArray) -> BoolArray:
    """Return a mask of the sizes that are not given, or that equal the known sizes."""
    return np.asarray(np.isnan(sizes) | (sizes == known))


def spread(frame: Frame, present: Present) -> PartialFrame:
    """Spread a frame of the present bodies over places for all bodies of the run."""
    ends, n = present.ends, present.bodies

    def wide(values: FloatArray | None, missing: FloatArray) -> FloatArray:
        found = np.tile(missing, (n, 1))
        found[present.numbers] = values
        return found

    nowhere, upright = np.full(3, np.nan), np.array([0.0, 0.0, 0.0, 1.0])
    values: dict[str, Any] = {field.name: getattr(frame, field.name) for field in fields(frame)}
    for name in ("position", "velocity", "acceleration", "angular_velocity"):
        values[name] = None if values[name] is None else wide(values[name], nowhere)
    if frame.orientation is not None:
        values["orientation"] = wide(frame.orientation, upright)
    pairs = ends[frame.contacts.pairs]
    turned = pairs[:, 0] > pairs[:, 1]  # the numbers of the bodies need not be in the order of the state
    order = np.lexsort(np.sort(pairs, axis=1).T[::-1])
    graph, sign = frame.contacts, np.where(turned, -1.0, 1.0)
    values["contacts"] = replace(
        graph,
        pairs=np.ascontiguousarray(np.sort(pairs, axis=1)[order]),
        normals=(sign[:, None] * graph.normals)[order],
        overlaps=graph.overlaps[order],
        colours=graph.colours[order],
    )
    if frame.contact_rows is not None:
        values["contact_rows"] = _renumbered(frame.contact_rows, ends)
    return PartialFrame(**values | {"slot": None, "present": present.numbers})


def without_bodies(last: Frame, step: int, time: float) -> PartialFrame:
    """Return a frame in which no body exists and nothing happens, given the previous frame."""
    values: dict[str, Any] = {field.name: getattr(last, field.name) for field in fields(last)}
    for name in ("position", "velocity", "acceleration", "angular_velocity"):
        values[name] = None if values[name] is None else np.full_like(values[name], np.nan)
    rows = None if last.contact_rows is None else last.contact_rows[:0]
    energy = replace(last.energy, translational=0.0, rotational=0.0, gravitational=0.0, field=0.0)
    changed: dict[str, Any] = {"step": step, "time": time, "dt": time - last.time, "previous_dt": time - last.time}
    changed |= {"contacts": empty_graph(), "contact_rows": rows, "energy": energy, "events": (), "dt_limit": "engine"}
    changed |= {"momentum": np.zeros(3), "angular_momentum": np.zeros(3), "momentum_error": None}
    changed |= {"angular_momentum_error": None, "slot": None, "present": np.empty(0, np.int64)}
    return PartialFrame(**values | changed)


def _renumbered(rows: Records, ends: IntArray) -> Records:
    """Return rows of contacts whose ends have other numbers, sorted by pair."""
    found = rows.copy()
    i, j = ends[rows["i"]], ends[rows["j"]]
    found["i"], found["j"] = np.minimum(i, j), np.maximum(i, j)
    turned = i > j
    for name in ("nx", "ny", "nz", "friction_x", "friction_y", "friction_z"):
        found[name][turned] *= -1.0
    return found[np.lexsort((found["j"], found["i"]))]
