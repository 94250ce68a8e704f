"""Signs of dissipation: contacts may remove energy only as their law says.

The ledger and the energy agree whatever an impulse does, so they cannot reveal a contact that dissipates wrongly. Four
statements can be tested (docs/physics.md, section 11):

- an impact at its own time removes ½ μ (1 - e²) v_n², no more and no less;
- an impact rebounds, however slow it is, unless a force closes the contact again within the step;
- friction adds no energy, in an impact or to an island;
- static friction does no work.

Impacts are tested in every step, lasting contacts in steps that end with a check. Lasting contacts are tested by
island, because the energy of a change of impulses cannot be divided uniquely among the contacts of a pile.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple, Protocol

import numpy as np

from carom.arrays import FloatArray, IntArray, RecordArray, dtype_of
from carom.event import Event
from carom.physics.bodies import Bodies
from carom.physics.contact.constraints import ends_of
from carom.physics.contact.graph import comes_before
from carom.physics.contact.impact_log import MANY_IMPACTS, MAX_IN_COLLAPSE, Impacts
from carom.physics.contact.islands import join_islands, root_of
from carom.physics.contact.law import Materials, exerts_torque, material_index, restitution_of_impact, slides
from carom.physics.contact.loads import pressing
from carom.physics.contact.records import ContactRecord, ContactStateRecord, ImpactRecord, LoadRecord
from carom.physics.diagnostics.ledger import clear_terms
from carom.physics.jit.decorators import entry_of, inline, kernel
from carom.physics.vector import Vector, between
from carom.scene.rest_speed import PER_STEP
from carom.scene.schema import Coefficients
from carom.scene.start import HalfSpaces
from carom.scene.units.dimension import ENERGY, TIME
from carom.scene.units.system import UnitSystem
from carom.scene.wording import Names
from carom.state.books import Extreme, WrongWork

if TYPE_CHECKING:
    from carom.physics.contact.graph import OrderedContacts
    from carom.physics.contact.solver.contact_solver import ContactSolver
    from carom.physics.contact.solver.prepare import ImpulseCache

RESTITUTION, STOPPED, GAIN, HOLDING = range(4)  # the four statements above, as indices of arrays
WRONG = (
    "Impacts have not removed the energy that the coefficient of restitution prescribes",
    "Impacts that no force presses together have ended without their rebound",
    "Friction has added energy",
    "Static friction has changed the energy, although it can do no work",
)

# Tolerance as a fraction of the energy of an impact, ½ μ v_n². The actual and the required loss follow from one closing
# speed, so they differ only by rounding.
ROUNDED = 1e-9
# Tolerance as a fraction of the summed magnitudes of friction's work in both kicks of a step. If friction holds, the
# works in the two kicks cancel. The remainder is of the order of the angle by which normals and loads turn in a step,
# at most 0.2 rad. Wrong work of first order in the step does not cancel at all.
CANCELLED = 0.25
LARGEST_TURN = 0.2  # rad, largest turn of a normal in a step; islands that turn further are not tested
# largest relative difference of the two kicks' lengths; with drag the lengths differ, but the works still cancel
ALIKE = 0.1
SLOWEST = 1e-100  # m/s, replaces a closing speed of 0 in a held group
# smallest violation that is reported, relative to the energy scale; sweeps that end early cause less in all extremes
SIGNIFICANT = 1e-6

_ROUNDED = np.array([ROUNDED])
_IDLE, _STUCK, _OTHER = 1, 2, 4  # bits that describe a contact in the kicks


class WrongWorkRecord(Protocol):
    """The energy that contacts moved in violation of one of the statements."""

    energy: float  # J, energy so far
    worst: float  # J, largest violation by a single contact in a step
    i: int  # ends of the contact with the largest violation
    j: int
    step: int
    time: float  # s, time of the largest violation


WRONG_WORK = dtype_of(WrongWorkRecord)


class HeldContacts(Protocol):
    """The behaviour of a contact in the kicks around the last drift."""

    did: int  # bits of the contact in both kicks
    friction: float  # J, energy dissipated by friction in the first kick


HELD = dtype_of(HeldContacts)
NO_PAIRS: IntArray = np.empty((0, 2), np.int64)


class JudgedEnds(NamedTuple):
    """The ends of contacts and their materials."""

    rows: RecordArray[Coefficients]  # as in `Materials`
    places: IntArray
    inverse_mass: FloatArray  # (n + p,) 1/kg
    bodies: int  # n
    walls_move: bool  # whether walls move: an accelerating wall presses on bodies, so impacts on it need not rebound
    walls_curve: bool  # whether walls curve: a body that follows a curved wall approaches it at the end of a step


class SignsOfDissipation:
    """Tests the energy that the contacts of a run dissipate.

    Parameters
    ----------
    holds
        Whether the friction of sticking contacts is tested. This requires that no wall or image moves, since their
        velocity changes the slip, and that the solver makes enough sweeps to stop the slip.
    planes
        The planes and walls of the run.
    """

    def __init__(self, bodies: Bodies, materials: Materials, holds: bool, planes: HalfSpaces) -> None:
        self._bodies, self._holds = bodies, holds
        walls = planes.moves, planes.curves
        self._ends = JudgedEnds(materials.rows, materials.places, bodies.ends.inverse_mass, len(bodies), *walls)
        # the kernels, compiled for the records of the run
        self._note_held: Callable[..., None] | None = None
        self._judge_impacts: Callable[..., bool] | None = None
        self._judge_contacts: Callable[..., bool] | None = None
        self.rows = np.zeros(len(WRONG), WRONG_WORK)
        self._told = [False] * len(WRONG)
        self.forget()

    def forget(self) -> None:
        """Return to the state before the first step."""
        self.begin(0, 0.0, True)
        self.judges = False
        self.recall(())

    def begin(self, step: int, time: float, judged: bool) -> None:
        """Begin a step that ends at a time (s), and state whether the energy is checked at its end."""
        self._step, self._time, self.judges = step, time, judged
        if judged:
            self._held_pairs, self._held, self._kick = NO_PAIRS, np.empty(0, HELD), 0.0

    @property
    def memory(self) -> tuple[WrongWork, ...]:
        """The tally, for a checkpoint; empty if nothing was wrong."""
        if not self.any:
            return ()
        entries = zip(*(self.rows[name].tolist() for name in WRONG_WORK.names or ()), self._told, strict=True)
        return tuple(WrongWork(energy, worst, (i, j), *moment) for energy, worst, i, j, *moment in entries)

    def recall(self, memory: tuple[WrongWork, ...]) -> None:
        """Restore an earlier `memory`."""
        self.rows[:] = 0
        self.any = len(memory) > 0  # whether anything was wrong
        self._told = [False] * len(WRONG)
        for k, row in enumerate(memory):
            self.rows[k] = row.energy, row.worst, *row.pair, row.step, row.time
            self._told[k] = row.told
        self._known = float(self.rows["energy"].sum())  # J, energy of the rows at the last check

    def before_hold(self, contacts: OrderedContacts, solver: ContactSolver, last: ImpulseCache) -> None:
        """Note the contacts' behaviour in the last kick, before the first kick of a tested step.

        The records in ``solver`` have the same impulses as ``last``, except after a checkpoint.
        """
        self._held = np.zeros(len(contacts.pairs), HELD)
        held = contacts.pairs, contacts.order.place, solver.states
        note_last(*held, last.pairs, last.impulse, self._ends, self._held)

    def after_hold(self, contacts: OrderedContacts, solver: ContactSolver, kick: float) -> None:
        """Note the contacts' behaviour in the first kick, given its length in s."""
        self._held_pairs, self._kick = contacts.pairs, kick
        held = contacts.pairs, contacts.order.place, solver.contacts, solver.states
        asked = *held, self._ends, self._held
        note = self._note_held = self._note_held or entry_of(note_held, *asked)
        note(*asked)

    def judge_impacts(self, impacts: Impacts, dt: float, loads: RecordArray[LoadRecord]) -> None:
        """Test the impacts during a drift of dt (s), given the loads of the bodies in the first kick.

        If walls load contacts more than accelerations do, dt is longer by the same factor (`NearPairs.loading`).
        """
        pressed = dt, self._bodies.ends.acceleration, loads
        asked = impacts.log, self._ends, pressed, _ROUNDED, self._step, self._time, self.rows
        judge = self._judge_impacts = self._judge_impacts or entry_of(judge_impacts, *asked)
        self.any |= judge(*asked)

    def judge_contacts(
        self, contacts: OrderedContacts, solver: ContactSolver, impacts: Impacts, dt: float, kick: float
    ) -> None:
        """Test the contacts at the end of a step of dt (s) that ends with a check, after a last kick (s)."""
        alike = abs(kick - self._kick) <= ALIKE * self._kick
        resolved = contacts.pairs, contacts.order.place, solver.contacts, solver.states, impacts.pairs
        held = self._held_pairs, self._held, alike, alike and self._holds
        ends = self._bodies.ends
        pressed = dt, ends.acceleration, solver.loads, ends.velocity
        asked = resolved, self._ends, held, pressed, (self._step, self._time), self.rows
        judge = self._judge_contacts = self._judge_contacts or entry_of(judge_contacts, *asked)
        self.any |= judge(*asked)

    def error(self, scale: float) -> Extreme | None:
        """Return all wrong work divided by a scale (J), and the time of the worst violation; None if nothing is new."""
        if not self.any:
            return None
        total = float(self.rows["energy"].sum())
        if total == self._known:
            return None
        self._known = total
        worst = self.rows[int(np.argmax(self.rows["energy"]))]
        pair = int(worst["i"]), int(worst["j"])
        return Extreme(total / scale if scale > 0.0 else 1.0, int(worst["step"]), float(worst["time"]), pair)

    def warnings(self, scale: float, names: Names, units: UnitSystem) -> list[Event]:
        """Return the warnings at a check, one for each newly violated statement, given the energy scale (J)."""
        found = []
        for k in np.flatnonzero(self.rows["energy"] > SIGNIFICANT * scale).tolist():
            if not self._told[k]:
                self._told[k] = True
                row = self.rows[k]
                energy, worst = (units.text(float(row[name]), ENERGY, ".3g") for name in ("energy", "worst"))
                share = f"{float(row['energy']) / scale:.2g} of the scale" if scale > 0.0 else "of none"
                pair = names.pair((int(row["i"]), int(row["j"])))
                at = units.text(float(row["time"]), TIME)
                text = f"{WRONG[k]}: {energy} so far ({share}). The largest part is {worst}, by {pair} at t = {at}."
                found.append(Event(self._step, self._time, "WARN", text, "dissipation"))
        return found


@kernel
def note_last(
    pairs: IntArray,
    place: IntArray,
    states: RecordArray[ContactStateRecord],
    last_pairs: IntArray,
    last_impulse: FloatArray,
    ends: JudgedEnds,
    held: RecordArray[HeldContacts],
) -> None:
    """Note each contact's behaviour in the last kick, and clear its work, which the ledger already contains.

    ``last_pairs``, (m, 2), sorted, and ``last_impulse``, (m, 4) N s, are an `ImpulseCache`.
    """
    rows, places, bodies = ends.rows, ends.places, ends.bodies
    b = 0
    for k in range(len(pairs)):
        clear_terms(states[place[k]])
        i, j = ends_of(pairs, k)
        while b < len(last_pairs) and comes_before(last_pairs[b, 0], last_pairs[b, 1], i, j):
            b += 1
        held[k].did = _IDLE
        if b < len(last_pairs) and last_pairs[b, 0] == i and last_pairs[b, 1] == j:
            Jn, x, y, z = last_impulse[b, 0], last_impulse[b, 1], last_impulse[b, 2], last_impulse[b, 3]
            held[k].did = _what(Jn, (x, y, z), rows[material_index(i, j, bodies, places)])


@kernel
def note_held(
    pairs: IntArray,
    place: IntArray,
    contacts: RecordArray[ContactRecord],
    states: RecordArray[ContactStateRecord],
    ends: JudgedEnds,
    held: RecordArray[HeldContacts],
) -> None:
    """Note each contact's behaviour in the first kick, in the order of the pairs, and the work of its friction."""
    rows, places, bodies = ends.rows, ends.places, ends.bodies
    for k in range(len(pairs)):
        (i, j), contact = ends_of(pairs, k), contacts[place[k]]
        held[k].did |= _what_it_does(contact, rows[material_index(i, j, bodies, places)])
        held[k].friction = states[place[k]].friction_loss


@inline
def _what_it_does(contact: ContactRecord, material: Coefficients) -> int:
    return _what(contact.normal_impulse, (contact.friction_x, contact.friction_y, contact.friction_z), material)


@inline
def _what(Jn: float, friction: Vector, material: Coefficients) -> int:
    """Return the behaviour of a contact with these impulses (N s)."""
    if not Jn > 0.0:
        return _IDLE
    if exerts_torque(material):  # the work of the torque on spins is booked as friction
        return _OTHER
    return _OTHER if slides(material, Jn, friction[0], friction[1], friction[2]) else _STUCK


@inline
def _add(row: WrongWorkRecord, energy: float, i: int, j: int, step: int, time: float) -> bool:
    row.energy += energy
    if energy > row.worst:
        row.worst, row.i, row.j, row.step, row.time = energy, i, j, step, time
    return True


@kernel
def judge_impacts(
    log: RecordArray[ImpactRecord],
    ends: JudgedEnds,
    pressed: tuple[float, FloatArray, RecordArray[LoadRecord]],
    tolerance: FloatArray,
    step: int,
    time: float,
    wrong: RecordArray[WrongWorkRecord],
) -> bool:
    """Compare the loss of each impact with the loss that its closing speed requires; return whether any is wrong.

    ``tolerance`` is the allowed error relative to ½ μ v_n², one value for each impact or one for all impacts. The
    impulses of a held group act at one time, so only the sum of their energies has a meaning.
    """
    rows, places, inverse_mass, bodies, walls_move, _ = ends
    dt, acceleration, loads = pressed
    impacts, found = places[:0, 0], False  # impacts of each body, counted if necessary
    together, largest, a, b = 0.0, 0.0, 0, 0
    for row in range(len(log)):
        entry = log[row]
        if row > 0 and entry.clock != log[row - 1].clock:
            if together != 0.0:
                found = _add(wrong[RESTITUTION], abs(together), a, b, step, time)
            together = largest = 0.0
        i, j, v = entry.i, entry.j, entry.approach
        Kn = inverse_mass[i] + inverse_mass[j]
        struck = 0.5 * v * v / Kn
        material, speed = rows[material_index(i, j, bodies, places)], max(v, SLOWEST)
        e = restitution_of_impact(material, speed, 0.0, Kn, entry.arm_i, entry.arm_j)
        tolerated = tolerance[min(row, len(tolerance) - 1)] * struck
        if entry.friction_loss < -tolerated:
            found = _add(wrong[GAIN], -entry.friction_loss, i, j, step, time)
        excess = entry.restitution_loss - (1.0 - e * e) * struck
        if np.isnan(e):  # the coefficient is unknown, but at most 1
            excess = min(0.0, entry.restitution_loss)
        if abs(excess) <= tolerated:
            continue
        is_impact = v > entry.rest_speed or v == 0.0  # only held groups have contacts that do not close
        if not is_impact:
            may_stop = walls_move and j >= bodies
            normal = entry.nx, entry.ny, entry.nz
            if may_stop or not v > PER_STEP * dt * pressing(i, j, normal, acceleration, loads):
                continue
        if not e >= 1.0 and len(impacts) == 0:  # also true if e is unknown
            impacts = _count_impacts(log, bodies)
        most = 0 if e >= 1.0 else max(impacts[i], impacts[j] if j < bodies else 0)
        if is_impact and most < MAX_IN_COLLAPSE:
            together += excess
            if abs(excess) > largest:
                largest, a, b = abs(excess), i, j
        if not is_impact and most < MANY_IMPACTS:
            found = _add(wrong[STOPPED], e * e * struck, i, j, step, time)
    if together != 0.0:
        found = _add(wrong[RESTITUTION], abs(together), a, b, step, time)
    return found


@kernel
def _count_impacts(log: RecordArray[ImpactRecord], bodies: int) -> IntArray:
    """Return the number of impacts of each body, (n,)."""
    counts = np.zeros(bodies, np.int64)
    for k in range(len(log)):
        counts[log[k].i] += 1
        if log[k].j < bodies:
            counts[log[k].j] += 1
    return counts


@kernel
def judge_contacts(
    resolved: tuple[IntArray, IntArray, RecordArray[ContactRecord], RecordArray[ContactStateRecord], IntArray],
    ends: JudgedEnds,
    before: tuple[IntArray, RecordArray[HeldContacts], bool, bool],
    pressed: tuple[float, FloatArray, RecordArray[LoadRecord], FloatArray],
    now: tuple[int, float],
    wrong: RecordArray[WrongWorkRecord],
) -> bool:
    """Test the contacts at the end of a step: impacts that stop, elastic impacts, and the friction of each island.

    Return whether anything is wrong. An island is not tested if an impact or a lost contact makes its two kicks differ.
    The last element of ``resolved`` is the array of pairs with an impact during the drift.
    """
    pairs, place, contacts, states, struck_pairs = resolved
    step, time = now
    rows, places, inverse_mass, bodies, walls_move, walls_curve = ends
    held_pairs, held, alike, holds = before
    dt, acceleration, loads, velocity = pressed
    count = len(inverse_mass)
    island = np.arange(count)
    join_islands(pairs, inverse_mass, island)
    join_islands(held_pairs, inverse_mass, island)
    friction, magnitude, found = np.zeros(count), np.zeros(count), False
    largest, worst = np.zeros(count), np.full(count, -1)
    is_judged, sticks_only = np.full(count, alike), np.full(count, holds)
    for k in range(len(struck_pairs)):
        _exclude(struck_pairs[k, 0], struck_pairs[k, 1], inverse_mass, island, is_judged)
    b = 0
    for k in range(len(pairs)):
        (i, j), c = ends_of(pairs, k), place[k]
        contact, state = contacts[c], states[c]
        while b < len(held_pairs) and comes_before(held_pairs[b, 0], held_pairs[b, 1], i, j):
            if held[b].did != _IDLE:  # the second kick of the contact is missing
                _exclude(held_pairs[b, 0], held_pairs[b, 1], inverse_mass, island, is_judged)
            b += 1
        material = rows[material_index(i, j, bodies, places)]
        root = root_of(island, i if inverse_mass[i] > 0.0 else j)
        did, lost, size = _what_it_does(contact, material), state.friction_loss, abs(state.friction_loss)
        known = b < len(held_pairs) and held_pairs[b, 0] == i and held_pairs[b, 1] == j
        if known:
            did, lost, size = did | held[b].did, lost + held[b].friction, size + abs(held[b].friction)
            b += 1
        if not (did == _IDLE or (known and did == _STUCK)) or state.approach_speed > state.rest_speed:
            sticks_only[root] = False
        if j < bodies and _turn(contact, between(velocity, i, j), dt) > LARGEST_TURN:
            is_judged[root] = False
        friction[root] += lost
        magnitude[root] += size
        if worst[root] < 0 or abs(lost) > largest[root]:
            largest[root], worst[root] = abs(lost), k
        v = state.approach_speed
        if not v > 0.0:
            continue
        Kn = inverse_mass[i] + inverse_mass[j]
        e = restitution_of_impact(material, v, 0.0, Kn, contact.arm_i, contact.arm_j)
        struck = 0.5 * v * v / Kn
        if v > state.rest_speed:
            excess = abs(state.restitution_loss)
            if e >= 1.0 and not contact.normal_impulse > 0.0 and excess > ROUNDED * struck:
                found = _add(wrong[RESTITUTION], excess, i, j, step, time)
            continue
        normal = contact.nx, contact.ny, contact.nz
        stopped = e > 0.0 and contact.normal_impulse > 0.0 and not ((walls_move or walls_curve) and j >= bodies)
        if stopped and v > PER_STEP * dt * pressing(i, j, normal, acceleration, loads):
            found = _add(wrong[STOPPED], e * e * struck, i, j, step, time)
    while b < len(held_pairs):
        if held[b].did != _IDLE:
            _exclude(held_pairs[b, 0], held_pairs[b, 1], inverse_mass, island, is_judged)
        b += 1
    for root in range(count):
        work = friction[root]
        if worst[root] < 0 or not is_judged[root] or abs(work) <= CANCELLED * magnitude[root]:
            continue
        i, j = ends_of(pairs, worst[root])
        if sticks_only[root]:
            found = _add(wrong[HOLDING], abs(work), i, j, step, time)
        elif work < 0.0:
            found = _add(wrong[GAIN], -work, i, j, step, time)
    return found


@inline
def _turn(contact: ContactRecord, velocity: Vector, dt: float) -> float:
    """Return the angle by which the normal of two bodies turns in a step, given their relative velocity in m/s."""
    (vx, vy, vz), (nx, ny, nz) = velocity, (contact.nx, contact.ny, contact.nz)
    vn = vx * nx + vy * ny + vz * nz
    tx, ty, tz = vx - vn * nx, vy - vn * ny, vz - vn * nz
    return float(np.sqrt(tx * tx + ty * ty + tz * tz) * dt / (contact.arm_i + contact.arm_j))


@inline
def _exclude(i: int, j: int, inverse_mass: FloatArray, island: IntArray, is_judged: FloatArray) -> None:
    """Exclude the islands of two ends from the test."""
    if inverse_mass[i] > 0.0:
        is_judged[root_of(island, i)] = False
    if inverse_mass[j] > 0.0:
        is_judged[root_of(island, j)] = False
