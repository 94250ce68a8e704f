"""Effects of contacts in an interval, in a run and in its repetition with shorter steps, and allowed differences.

A step treats the load of a contact as acting at one instant. Let J be the impulse of the load in a step, and a the
acceleration that forces cause. If an impact, or the end of sliding, lies within the step, velocities differ by up to 2
J/m along the contact's normal, and by up to 2 a dt along a. An impact passes on the part of such a load that lies along
the impact's normal. Further impacts pass on this part, and friction turns a fraction of it into other directions. Loads
allow no difference if no contact began, ended or changed its mode, and none across their normals: a rolling ball
follows its path, and a slow impact along a floor bounces, whatever load the floor carries.

Two errors of first order are allowed in addition. A load that lasts, but changes by ΔJ from one step to the next, as in
a buckling column, is uncertain by ΔJ. The closing speed of a body that rests on something is uncertain by a dt/2 along
the normal. The impulses of the body's impact, and their effects on all touching bodies, have the same relative
uncertainty: a light ball squeezed out by heavy ones leaves with this relative error.

If several contacts acted, physics determines neither how they share impulses nor the order of simultaneous impacts. The
runs then agree on touching bodies if the bodies keep the same share of their energy. Plastic impacts of a heavy ball
may end all of its motion, and leave a light ball with a millionth of the energy; the order of the impacts decides how
much.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from scipy.optimize import lsq_linear
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from carom.arrays import FloatArray, IntArray, Records
from carom.contact_table import IMPACT_MODE, NO_ROWS
from carom.physics.schedule import every
from carom.physics.space import Space
from carom.scene.load import Scene
from carom.scene.start import InitialBodies
from carom.scene.wording import Names
from carom.state.frame import Frame

LASTS = 4  # steps after which a pressing contact carries a load; the force that stops a slow impact ends sooner
LOOK_AFTER = LASTS + 1.0  # steps after an interval that are read for the loads of contacts
RETURNS = 2.0  # steps; a bounce that would take longer (2 v/a) must not end at rest within a step
SHARED = 5e-2  # fraction of the touching bodies' kinetic energy by which two runs may differ in how they share impulses
# relative change (or rad), in a step, of a torque that resists rolling; the error of the torque is of first order
TURNED = 0.01
FAST = 10.0  # factor by which the speed of a supported body's impact must exceed its uncertainty
SURFACE = 2.5  # m r²/I of a ball: by this factor, friction changes its surface speed more than its velocity

MOST_IMPACTS = 3  # largest number of impacts that a message lists

Pair = tuple[int, int]  # numbers of two bodies; numbers ≥ n are planes and walls
Impacts = tuple[tuple[str, float], ...]  # names of both ends, and closing speed in m/s


class Spaces:
    """Makes spaces of a scene from its start, and restores them to states of the run."""

    def __init__(self, scene: Scene, start: InitialBodies, threads: int | None, check_interval: float | None) -> None:
        self.scene, self.start = scene, start
        self._threads, self._check_interval = threads, check_interval

    def space(self, stride: float = 1.0, contacts: bool = False, max_dt: float | None = None) -> Space:
        """Make a space whose steps are ``stride`` times as long, and at most ``max_dt`` seconds."""
        scene = self.scene
        if max_dt is not None:
            scene = scene.model_copy(update={"time": scene.time.model_copy(update={"max_dt": max_dt})})
        space = Space(scene, self._threads, self.start, stride, record_contacts=contacts)
        space.check_interval = self._check_interval
        return space


class Load(NamedTuple):
    """The largest change of a body's velocity that the load of a contact, or a force, causes in a step."""

    direction: FloatArray  # (3,)
    speed: float  # m/s
    rubs: bool  # whether the contact that carries the load has friction


@dataclass(slots=True)
class RunInterval:
    """The effects of contacts in an interval of one run."""

    impacts: Records
    pressed: dict[Pair, float]  # N s, largest impulse in a step of each contact that was not an impact
    changed: set[int]  # bodies with an impact, or with a contact that began, ended or changed its mode
    loads: dict[int, list[Load]]  # loads by body
    eased: dict[int, list[Load]]  # by body, the differences in load between the last step and the step before it
    depth: FloatArray  # (n,) m, deepest overlap of each body; another run may correct it at another time
    friction: float  # the largest ratio of a tangential to a normal impulse
    vague: dict[Pair, float]  # largest relative uncertainty of fast impacts of supported bodies, by pair

    @property
    def pairs(self) -> set[Pair]:
        """The pairs that pressed each other or met."""
        return {(int(row["i"]), int(row["j"])) for row in self.impacts} | set(self.pressed)


@dataclass(frozen=True, slots=True)
class Touching:
    """Bodies that touched or met, directly or through others, and the effects on them in both runs."""

    bodies: frozenset[int]
    contacts: int  # number of pairs that touched or met
    changes: bool  # whether any contact began, ended or changed its mode, or bodies met
    loads: list[Load]
    eased: list[Load]
    last_impact: float  # s, time of the last impact; -infinity without one
    depth: float  # m, depth of the deepest overlap
    friction: float
    vague: float  # relative uncertainty of the effects of impacts

    def excess(self, vector: FloatArray, share: float = 1.0) -> float:
        """Return by how much a difference exceeds the allowance for loads, which is multiplied by ``share``."""
        return _beyond(vector, [*self.eased, *(self.loads if self.changes else [])], share)

    @property
    def rubbed(self) -> float:
        """The largest change of a velocity by friction (m/s), if impacts may turn loads round."""
        return 2.0 * _rubbed(self.loads, self.friction) if self.changes else 0.0


@dataclass(slots=True)
class CloseLook:
    """The effects of contacts in an interval of both runs."""

    run: RunInterval
    refined: RunInterval
    start: InitialBodies
    _labels: IntArray = field(init=False)  # (n,) label shared by bodies that touch, directly or through free bodies
    _known: dict[int, Touching] = field(init=False, default_factory=dict)  # the touching bodies by label

    def __post_init__(self) -> None:
        n, free = len(self.start.mass), ~np.asarray(self.start.fixed)
        ends = [pair for pair in self.run.pairs | self.refined.pairs if max(pair) < n and free[list(pair)].all()]
        i, j = np.array(ends, np.int64).reshape(-1, 2).T
        _, self._labels = connected_components(coo_array((np.ones(len(i)), (i, j)), shape=(n, n)), directed=False)

    def touching(self, body: int) -> Touching:
        """Return the bodies that touched a body."""
        label = int(self._labels[body])
        if label not in self._known:
            bodies, both = frozenset(np.flatnonzero(self._labels == label).tolist()), (self.run, self.refined)
            hit = [row["time"] for each in both for row in each.impacts if bodies & {int(row["i"]), int(row["j"])}]
            self._known[label] = Touching(
                bodies=bodies,
                contacts=sum(bool(bodies & set(pair)) for pair in self.run.pairs | self.refined.pairs),
                changes=any(bodies & each.changed for each in both),
                loads=[load for each in both for body in bodies for load in each.loads.get(body, [])],
                eased=[load for body in bodies for load in self.run.eased.get(body, [])],
                last_impact=max(hit, default=-math.inf),
                depth=max(float(each.depth[body]) for each in both for body in bodies),
                friction=max(each.friction for each in both),
                vague=2.0 * sum(share for ends, share in self.run.vague.items() if bodies & set(ends)),
            )
        return self._known[label]

    def impacts_of(self, body: int, names: Names) -> tuple[Impacts, Impacts]:
        """Return the first impacts of a body in the interval, in the run and with shorter steps."""
        found: list[Impacts] = []
        for run in (self.run, self.refined):
            rows = [row for row in run.impacts if body in (row["i"], row["j"])][:MOST_IMPACTS]
            met = ((names.pair((int(row["i"]), int(row["j"]))), float(row["approach_speed"])) for row in rows)
            found.append(tuple(met))
        return found[0], found[1]

    def may_share_otherwise(self, touching: Touching, before: Frame, frame: Frame, refined: Frame) -> bool:
        """Return whether several contacts acted, and both runs have the same energy within the allowance for loads."""
        if touching.contacts < 2:
            return False
        had, kept, refined_kept = (self._kinetic(touching, one) for one in (before, frame, refined))
        return abs(kept - refined_kept) <= SHARED * max(had, kept, refined_kept)

    def _kinetic(self, touching: Touching, frame: Frame) -> float:
        """Return the kinetic energy (J) of bodies that touched, without the allowances for loads and friction."""
        mass, radius, inertia, energy = self.start.mass, self.start.radius, self.start.inertia, 0.0
        for body in touching.bodies:
            loads = self.run.loads.get(body, [])
            rubbed = _rubbed(loads, touching.friction)
            energy += 0.5 * float(mass[body]) * max(0.0, _beyond(frame.velocity[body], loads, 1.0) - rubbed) ** 2
            if frame.angular_velocity is not None:
                surface = float(np.sqrt((frame.angular_velocity[body] ** 2).sum()) * radius[body])
                turns = max(0.0, surface - SURFACE * rubbed) / float(radius[body])
                energy += 0.5 * float(inertia[body]) * turns * turns
        return energy

    def lacks_a_bounce(self, touching: Touching, refined: Frame) -> bool:
        """Return whether the run kept a pair in contact that bounces for longer than a step in the finer run."""
        bounced = {(int(row["i"]), int(row["j"])) for row in self.run.impacts}
        energy = self._kinetic(touching, refined)
        for row in self.refined.impacts:
            ends = int(row["i"]), int(row["j"])
            if ends in bounced or not touching.bodies & set(ends) or self.run.pressed.get(ends, 0.0) <= 0.0:
                continue
            approach = float(row["approach_speed"])
            if 0.5 * _reduced_mass(ends, self.start) * approach * approach <= SHARED * energy:
                continue  # the contacts then share impulses in the same way
            normal = _normal(row)
            returned = 0.0  # m/s, change of speed in a step by loads along the normal and by friction
            for load in (load for end in ends for load in self.run.loads.get(end, [])):
                along = abs(float(load.direction @ normal))
                across = math.sqrt(max(0.0, 1.0 - along * along))
                returned += load.speed * (along + (touching.friction * across if load.rubs else 0.0))
            if 2.0 * approach > RETURNS * returned:
                return True
        return False


def _reduced_mass(ends: Pair, start: InitialBodies) -> float:
    """Return the reduced mass (kg) of a pair; planes, walls and fixed bodies are immovable."""
    return 1.0 / sum(1.0 / float(start.mass[end]) for end in _movable(ends, start))


def _movable(ends: Pair, start: InitialBodies) -> list[int]:
    """Return the ends of a contact that are neither planes, walls nor fixed bodies."""
    return [end for end in ends if end < len(start.mass) and not start.fixed[end]]


def _beyond(vector: FloatArray, loads: list[Load], share: float) -> float:
    """Return the remainder of a difference that exceeds the velocity changes that loads allow, times ``share``.

    Each load allows a difference of twice its change in a step, since an impact may reverse the load. All loads
    together may leave a smaller remainder than the same loads one after the other: a light ball between two heavy ones
    is pushed out across two normals that are nearly opposite.
    """
    rest, along = vector, np.array([2.0 * load.speed * share * load.direction for load in loads]).T
    size = float(np.abs(along).max(initial=0.0))
    if size > 0.0 and vector.any():
        rest = vector - along @ lsq_linear(along / size, vector / size, (-1.0, 1.0)).x
    return float(np.sqrt(rest @ rest))


def _rubbed(loads: list[Load], friction: float) -> float:
    return friction * max((load.speed for load in loads if load.rubs), default=0.0)


def look_closely(space: Space, frame: Frame, begin: float, end: float, dt: float, start: InitialBodies) -> RunInterval:
    """Repeat the steps from a frame to the end (s) of an interval, and look at its contacts.

    The space records contacts. Steps before the beginning (s) of the interval, and some steps of ``dt`` (s) after its
    end, show which contacts last, and their loads.
    """
    space.restore(frame.checkpoint)
    n, free, mass = len(start.mass), ~np.asarray(start.fixed), start.mass
    impacts, friction, first = [NO_ROWS], 0.0, space.step
    changed: set[int] = set()
    pressed: dict[Pair, float] = {}
    depth = np.zeros(n)
    rolls: dict[Pair, FloatArray] = {}  # m, angular impulse against rolling and twisting, divided by the normal impulse
    held: dict[Pair, tuple[float, FloatArray]] = {}  # impulses (N s) and normals of lasting contacts
    lasting: dict[Pair, list[float]] = {}  # impulses (N s) in the last steps
    pulled, modes = dict[int, Load](), set[tuple[int, int, int]]()
    vague: dict[Pair, float] = {}
    eased: dict[Pair, tuple[float, FloatArray]] = {}  # changes of impulses (N s), and normals, as in `held`
    for one in space.run(until=end + LOOK_AFTER * dt, schedule=every(0.0)):
        if one.step == first:  # a restored state has no contact table
            continue
        inside = one.time > begin
        counts = inside and one.time <= end + dt
        if one.impacts is not None and inside:
            impacts.append(one.impacts[one.impacts["time"] <= end])
            _blur(vague, impacts[-1], {body for *ends, _ in modes for body in ends if body < n}, one)
        rows = NO_ROWS if one.contact_rows is None else one.contact_rows
        if inside:
            _deepen(depth, rows, start.radius)
        rows = rows[(rows["mode"] != IMPACT_MODE) & (rows["normal_impulse"] > 0.0)]
        seen = set(zip(rows["i"].tolist(), rows["j"].tolist(), rows["mode"].tolist(), strict=True))
        if one.step > first + 1 and counts:
            changed |= {body for i, j, _ in modes ^ seen for body in (i, j)}
        modes, before, rolled, lasting, rolls = seen, lasting, rolls, {}, {}
        for row in rows:
            ends, impulse = (int(row["i"]), int(row["j"])), float(row["normal_impulse"])
            rolls[ends] = np.array([row["angular_x"], row["angular_y"], row["angular_z"]]) / impulse
            if counts and ends in rolled and _turned(rolled[ends], rolls[ends]):
                changed |= set(ends)
            if counts:
                pressed[ends] = max(pressed.get(ends, 0.0), impulse)
            lasting[ends] = [*before.get(ends, []), impulse][-LASTS:]
            if len(lasting[ends]) < LASTS:
                continue
            least, change = min(lasting[ends]), abs(impulse - lasting[ends][-2])
            normal = _normal(row)
            if least > held.get(ends, (0.0, None))[0]:
                held[ends] = least, normal
            if counts and change > eased.get(ends, (0.0, None))[0]:
                eased[ends] = change, normal
        if not inside:
            continue
        friction = max(friction, _largest_friction(rows))
        pull = np.sqrt((one.acceleration**2).sum(axis=1)) * one.dt
        known = np.array([pulled[body].speed if body in pulled else 0.0 for body in range(n)])
        for body in np.flatnonzero((pull > known) & free).tolist():
            size = math.sqrt(float((one.acceleration[body] ** 2).sum()))
            pulled[body] = Load(one.acceleration[body] / size, float(pull[body]), rubs=False)
    found = np.concatenate(impacts)
    loads: dict[int, list[Load]] = {body: [load] for body, load in pulled.items()}
    changes: dict[int, list[Load]] = {}
    for impulses, by_body in ((held, loads), (eased, changes)):
        for ends, (impulse, normal) in impulses.items():
            for body in _movable(ends, start):
                by_body.setdefault(body, []).append(Load(normal, impulse / float(mass[body]), rubs=True))
    for row in found:
        _load_of_impact(row, loads, start)
    changed |= set(found["i"].tolist()) | set(found["j"].tolist())
    return RunInterval(found, pressed, changed, loads, changes, depth, max(friction, _largest_friction(found)), vague)


def _blur(vague: dict[Pair, float], impacts: Records, supported: set[int], frame: Frame) -> None:
    """Raise the uncertainty of each pair to that of its impacts in a step; ``supported`` bodies are at rest."""
    for row in impacts:
        ends, normal = (int(row["i"]), int(row["j"])), _normal(row)
        uncertain = 0.5 * frame.dt * sum(abs(float(frame.acceleration[end] @ normal)) for end in supported & set(ends))
        if 0.0 < FAST * uncertain < row["approach_speed"]:
            vague[ends] = max(vague.get(ends, 0.0), uncertain / float(row["approach_speed"]))


def _load_of_impact(row: np.void, loads: dict[int, list[Load]], start: InitialBodies) -> None:
    """Add, to the loads of both bodies, the part of their support that an impact passes on.

    The closing speed of a body that rests on something contains half of the impulse of its support in a step, along the
    normal of the impact (docs/physics.md, section 9).
    """
    ends = int(row["i"]), int(row["j"])
    normal = _normal(row)
    support = 0.5 * sum(
        load.speed * abs(float(load.direction @ normal)) for end in ends for load in loads.get(end, []) if load.rubs
    )
    if support > 0.0:
        reduced = _reduced_mass(ends, start)
        for end in _movable(ends, start):
            loads.setdefault(end, []).append(Load(normal, support * reduced / float(start.mass[end]), rubs=True))


def _normal(row: np.void) -> FloatArray:
    """Return the normal of a contact or an impact, (3,)."""
    return np.array([row["nx"], row["ny"], row["nz"]])


def _deepen(depth: FloatArray, rows: Records, radius: FloatArray) -> None:
    """Raise the depths (n,) m of bodies, if their overlaps in the rows of contacts are deeper."""
    reach = np.append(radius, 0.0)  # the arm of a plane or wall is 0
    ends = np.minimum(np.stack((rows["i"], rows["j"])), len(radius))
    overlap = reach[ends].sum(axis=0) - rows["arm_i"] - rows["arm_j"]
    for end in ends:
        moves = end < len(radius)
        np.maximum.at(depth, end[moves], overlap[moves])


def _turned(before: FloatArray, now: FloatArray) -> bool:
    """Return whether the resistance to rolling or twisting has changed direction, or ends the rotation."""
    change = now - before
    return bool(change @ change > (TURNED * TURNED) * max(before @ before, now @ now))


def _largest_friction(rows: Records) -> float:
    """Return the largest ratio of a tangential to a normal impulse."""
    rows = rows[rows["normal_impulse"] > 0.0]
    tangential = np.sqrt(rows["friction_x"] ** 2 + rows["friction_y"] ** 2 + rows["friction_z"] ** 2)
    return float((tangential / rows["normal_impulse"]).max(initial=0.0))
