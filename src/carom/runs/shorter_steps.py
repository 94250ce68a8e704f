"""Compares a run with shorter steps at a few hundred instants, window by window.

Chaos is not a fault, so runs are compared in windows. At the start of a window, the second run starts anew from the
state of the run, and so does a *twin*: it has the steps of the run, but its positions differ in the last bit. If the
distance between twin and run has grown by the factor G, an error made in the window may have grown as much. A body is
therefore compared with tolerances times G, and no longer compared once G exceeds `MOST_GROWTH`. A window ends when few
bodies can still be compared. Regular motion has a single window, the whole run. The entries of the ledger are compared
by statistics: the mean difference in an interval between two instants is a fault if it is certain, and adds up to more
than a tolerance.

If bodies differ, both runs are repeated from the previous instant with all contacts, and `close_look` computes the
differences that loads and the sharing of impulses allow.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, replace

import numpy as np

from carom.arrays import BoolArray, FloatArray
from carom.physics.contact.solver.solve import HOLD_CONVERGED
from carom.physics.schedule import at
from carom.physics.space import Space
from carom.physics.vector import minimum_images
from carom.plan.auto import integrator
from carom.runs.close_look import LASTS, SURFACE, CloseLook, Impacts, Spaces, look_closely
from carom.scene.units.dimension import OF_UNIT, TIME, VELOCITY
from carom.scene.units.system import SI, UnitSystem
from carom.scene.wording import Names
from carom.state.books import NOTHING
from carom.state.energies import Energy
from carom.state.frame import Frame

# tolerance of positions relative to radius and distance covered, of velocities relative to the body's speed
STATE = 1e-3
PULLED = 0.1  # tolerance of velocities relative to their change in a step by forces that vary along a path
ROUGH = 20.0  # factor on the tolerances of bodies that rub under load while a contact begins, ends or changes its mode
LEDGER = 1e-3  # tolerance of a ledger entry relative to the moved energy; the default of `record.energy_tolerance`
# tolerance of a ledger entry in one interval, relative to the kinetic energy, if bodies with most of it move
# predictably
SUDDEN = 0.2
CHAOTIC = 5e-2  # tolerance of a ledger entry if chaos ends the comparison of bodies, so that entries are statistics
REGULAR = 0.99  # `LEDGER` applies only if more than this fraction of the motion was compared, otherwise `CHAOTIC`
OVERLAP = 5e-2  # tolerance of overlaps relative to the smaller radius; a step may move bodies by half a radius or more
MOST_GROWTH = 300.0  # growth beyond which a twin's tolerance of positions would be a third of the distance covered
COMPARABLE = 0.5  # a new window begins when less than this fraction of the free bodies is comparable
CERTAIN = 4.0  # number of standard errors at which the mean difference of a ledger entry is certain
FEWEST_INTERVALS = 8  # smallest number of intervals for a mean difference
AT_REST = 1e-6  # speed, relative to the largest, below which bodies are compared as if they had this speed
EPS = float(np.finfo(np.float64).eps)

CALLED = {"position": "distance covered", "velocity": "velocity", "spin": "speed of the surface"}

FRICTION, FORCES, CORRECTED = 1, 2, -1  # indices of ledger entries: see `_entries`


@dataclass(frozen=True, slots=True)
class Moved:
    """An observable that shorter steps move by more than the method allows."""

    observable: str  # "position", "velocity", "spin", "overlap", or the name of a ledger entry
    begin: float  # s, time after which the difference appeared
    time: float  # s, time by which the difference had appeared
    bodies: tuple[int, ...]  # numbers of bodies and, if ≥ n, planes; empty for a ledger entry
    names: str  # names of these bodies; empty for a ledger entry
    run: float  # value in the run, in SI units; 0 for a distance
    refined: float  # value with shorter steps
    by: float  # size of the difference
    allowed: float  # largest allowed difference
    unit: str  # SI unit of the values; empty for pure numbers
    impacts: Impacts = ()  # the body's first few impacts in this interval of the run
    refined_impacts: Impacts = ()  # the body's first few impacts with shorter steps

    def text(self, units: UnitSystem = SI) -> str:
        """Describe the observable, in printed units."""
        dimension = OF_UNIT.get(self.unit)

        def shown(value: float) -> str:
            return f"{value:.3g}" if dimension is None else units.text(value, dimension, ".3g")

        when = f"t = {units.span(self.begin, self.time, TIME, '.6g')}"
        what = f"{self.observable} of {self.names}" if self.names else f"{self.observable} in the ledger"
        values = (
            f"{shown(self.run)} in the run, {shown(self.refined)} with shorter steps; {shown(self.allowed)} allowed"
        )
        lines = [f"{when}: {what} moves by {shown(self.by)} ({values})"]
        if self.impacts != self.refined_impacts:
            for told, impacts in (("in the run", self.impacts), ("with shorter steps", self.refined_impacts)):
                listed = [f"{names} at {units.text(speed, VELOCITY, '.3g')}" for names, speed in impacts]
                lines.append(f"impacts {told}: {', '.join(listed) or 'none'}")
        return "; ".join(lines)


def _reached(space: Space, time: float) -> Frame:
    """Run to a time (s); return the frame at that time."""
    *_, last = space.run(until=time, schedule=at(()))
    return last


def forget_overlap(space: Space) -> None:
    """Reset the deepest overlap, for the next interval."""
    if space.extremes.overlap is not None:
        space.extremes.overlap = NOTHING


class Comparison:
    """Compares the frames of a run with shorter steps, window by window."""

    def __init__(self, maker: Spaces, factor: float, names: Names) -> None:
        self._maker, self._factor, self._names = maker, factor, names
        start = maker.start
        self._free: BoolArray = ~np.asarray(start.fixed)  # (n,)
        self._mass, self._radius = start.mass, start.radius
        period = maker.scene.domain.period
        self._box = None if period is None else np.array(period)
        self._batches = integrator(maker.scene).controls_error
        self._twin = maker.space()
        self._fine: Space | None = None if self._batches else maker.space(1.0 / factor)
        self._closely: tuple[Space, Space] | None = None  # the run and the shorter steps, with contacts
        self._rng = np.random.default_rng(0)  # draws the directions in which twins are displaced
        self.last: Frame | None = None  # last frame of the run
        self._last_fine: Frame | None = None
        self._last_twin: Frame | None = None
        self.moved: list[Moved] = []
        self.largest: dict[str, float] = {}
        self.steps = self.refined_steps = self.instants = self.windows = self.shared = 0
        self._seen = self._bodies_seen = 0
        self._entries: tuple[str, ...] = ()
        self._differences: list[FloatArray] = []  # differences of the entries for each interval, J
        self._displaced = 0.0  # J, largest work of the forces over the differences of the positions in this window
        self._displaced_before = 0.0  # J, the sum of these works over earlier windows
        self._kinetic = 0.0  # J, largest kinetic energy so far
        self._certain = 0.0  # fraction of the kinetic energy in bodies that were comparable at the last instant
        self._opened: Frame | None = None
        self._past: deque[Frame] = deque(maxlen=2 * LASTS)  # the last frames of the run
        self._waiting: tuple[Frame, Frame] | None = None  # frames of both runs before impacts near the last instant

    @property
    def compared(self) -> float:
        """Fraction of all bodies and instants that were compared; at the others chaos decides."""
        return self._bodies_seen / self._seen if self._seen else 1.0

    def see(self, frame: Frame) -> None:
        """Compare a frame of the run; the first one starts the comparison."""
        before, self.last = self.last, frame
        self._kinetic = max(self._kinetic, frame.energy.translational + frame.energy.rotational)
        if before is None:
            self._entries, self._first = _entries(frame.energy)[0], frame.time
            self._opened = frame
            return
        if frame.step == before.step:
            return
        self._past.append(before)
        if self._opened is not None:
            self._open(before, (frame.time - before.time) / (frame.step - before.step))
        assert self._fine is not None and self._last_fine is not None and self._last_twin is not None
        fine_before, twin_before = self._last_fine, self._last_twin
        twin = self._last_twin = _reached(self._twin, frame.time)
        fine_step = self._fine.step
        fine = self._last_fine = _reached(self._fine, frame.time)
        self.steps += frame.step - before.step
        self.refined_steps += self._fine.step - fine_step
        self.instants += 1
        self._measure(before, frame, twin, fine)
        known = self._growth <= MOST_GROWTH
        compared = self._free & known
        self._seen += int(self._free.sum())
        self._bodies_seen += int(compared.sum())
        taken = _booked(before, frame)
        self._differences.append(_booked(fine_before, fine) - taken)
        self._judge_losses(before, frame, fine_before, fine, _booked(twin_before, twin) - taken)
        restart = self._judge(before, frame, fine_before, fine, compared)
        self._judge_overlaps(before, frame, fine)
        forget_overlap(self._fine)
        if restart or compared.sum() < COMPARABLE * self._free.sum():
            self._opened = frame

    def _judge_losses(self, before: Frame, frame: Frame, fine_before: Frame, fine: Frame, of_twin: FloatArray) -> None:
        """Compare the ledger entries of an interval that began with nearly all energy in bodies of predictable motion.

        Chaos within the interval may change which body has the energy, but hardly how much energy is left. An entry is
        compared if the twin agrees with the run. It is also compared if the twin agrees with the shorter steps, since
        then the run alone is wrong. The quantity must also differ two steps later, since an impact may be just before
        or just after the instant. If positions differ, forces have done different work, and contacts remove the energy
        that position corrections add. Within a step, forces may make bodies in contact approach each other; with
        shorter steps, these bodies bounce.
        """
        certain, self._certain = self._certain, self._certain_share(frame)
        taken, refined = _booked(before, frame), _booked(fine_before, fine)
        allowed = SUDDEN * max(self._kinetic_of(before).sum(), self._kinetic_of(frame).sum())
        allowed = max(allowed, (CHAOTIC if self.shared else LEDGER) * self._kinetic)
        displaced = self._moved_energy(before, frame, fine)
        self._displaced = max(self._displaced, displaced)
        allowed += displaced + abs(taken[CORRECTED]) + abs(refined[CORRECTED])
        gained = (frame.acceleration * frame.dt) ** 2
        allowed += 0.5 * float((self._mass * gained.sum(axis=1))[self._free].sum())
        differ = _without_what_slips(self._differences[-1])
        doubt = 10.0 * np.minimum(np.abs(of_twin), np.abs(differ - of_twin))
        differ = np.where(np.abs(differ) > allowed + doubt, differ, 0.0)
        if certain < 1.0 - CHAOTIC or not differ.any():
            return
        after = frame.time + 2.0 * frame.dt
        spaces = self._close_spaces(frame.dt)
        later = []
        for space, one in zip(spaces, (frame, fine), strict=True):
            space.restore(one.checkpoint)
            later.append(_reached(space, after))
        lasting = _without_what_slips(_booked(fine_before, later[1]) - _booked(before, later[0]))
        for k in np.flatnonzero(np.minimum(np.abs(differ), np.abs(lasting)) > allowed).tolist():
            values = float(taken[k]), float(refined[k]), abs(float(differ[k])), float(allowed)
            self._add(Moved(self._entries[k], before.time, frame.time, (), "", *values, "J"))

    def _moved_energy(self, before: Frame, frame: Frame, fine: Frame) -> float:
        """Return the work (J) of the forces over the differences of positions and the remaining closing of contacts.

        Contacts at rest close by up to `HOLD_CONVERGED` of the velocity that a force causes in a step.
        """
        force = self._mass[:, np.newaxis] * frame.acceleration
        work = np.abs((force * self._between(fine.position, frame.position)).sum(axis=1))
        work += HOLD_CONVERGED * frame.dt * (frame.time - before.time) * (force * frame.acceleration).sum(axis=1)
        return float(work[self._free].sum())

    def _kinetic_of(self, frame: Frame) -> FloatArray:
        """Return the kinetic energies of the bodies, (n,) J."""
        energy = 0.5 * self._mass * (frame.velocity**2).sum(axis=1)
        if frame.angular_velocity is not None:
            energy = energy + 0.5 * self._maker.start.inertia * (frame.angular_velocity**2).sum(axis=1)
        return np.where(self._free, energy, 0.0)

    def _certain_share(self, frame: Frame) -> float:
        """Return the fraction of the kinetic energy in bodies that can be compared."""
        energy = self._kinetic_of(frame)
        return float(energy[self._growth <= MOST_GROWTH].sum() / energy.sum()) if energy.any() else 0.0

    def finish(self) -> None:
        """Compare the entries of the ledger over all intervals.

        If the overlap of a heavy body is corrected by a millionth of its radius, its energy may change by more than a
        thousandth of the kinetic energy. Therefore the work of the forces over the difference of the positions is also
        allowed. Each window begins without a difference, so this work is summed over the windows.
        """
        if len(self._differences) < FEWEST_INTERVALS or self.last is None:
            return
        rows = np.array(self._differences)
        _, totals = _entries(self.last.energy)
        taken = abs(self.last.energy.ledger.restitution) + abs(self.last.energy.ledger.friction)
        regular = self.compared > REGULAR and not self.shared
        allowed = (LEDGER if regular else CHAOTIC) * max(self._kinetic, taken) + self._displaced_before
        allowed += self._displaced
        for k, name in enumerate(self._entries):
            total, error = float(rows[:, k].sum()), float(rows[:, k].std() * math.sqrt(len(rows)))
            self._note(f"ledger: {name}", abs(total), allowed)
            if abs(total) > allowed and abs(total) > CERTAIN * error:
                values = float(totals[k]), float(totals[k]) + total, abs(total), allowed
                self.moved.append(Moved(name, self._first, self.last.time, (), "", *values, "J"))

    def _open(self, frame: Frame, dt: float) -> None:
        """Begin a window at a frame of the run, whose steps are about dt seconds long."""
        self._opened = self._waiting = None
        self.windows += 1
        self._displaced_before += self._displaced
        self._displaced = 0.0
        checkpoint = frame.checkpoint
        reach = max(float(np.abs(frame.position).max()), float(self._radius.max()))
        self._apart = EPS * reach
        shift = self._apart * self._rng.choice([-1.0, 1.0], frame.position.shape)
        shift[~self._free] = 0.0
        self._twin.restore(replace(checkpoint, position=frame.position + shift))
        if self._batches:  # an integrator that makes batches of steps chooses them itself, unless the scene limits them
            self._fine = self._maker.space(1.0 / self._factor, max_dt=dt / self._factor)
        assert self._fine is not None
        self._fine.restore(checkpoint)
        forget_overlap(self._fine)
        self._last_fine = self._last_twin = frame
        n = len(frame.position)
        self._origin = frame.position
        self._pull, self._since = np.zeros(n), frame.time
        self._extent, self._growth, self._speed = np.zeros(n), np.ones(n), self._speeds(frame)
        self._certain = self._certain_share(frame)

    def _speeds(self, frame: Frame) -> FloatArray:
        """Return the speeds of the bodies' centres or surfaces, (n,) m/s."""
        speed = np.sqrt((frame.velocity**2).sum(axis=1))
        if frame.angular_velocity is not None:
            speed = np.maximum(speed, self._radius * np.sqrt((frame.angular_velocity**2).sum(axis=1)))
        return np.asarray(speed)

    def _between(self, one: FloatArray, other: FloatArray) -> FloatArray:
        """Return the vectors between positions of the same bodies, (n, 3) m."""
        return one - other if self._box is None else minimum_images(one - other, self._box)

    def _measure(self, before: Frame, frame: Frame, twin: Frame, fine: Frame) -> None:
        """Measure the growth of rounding, and the scales of positions and velocities."""
        apart = np.abs(self._between(twin.position, frame.position)).max(axis=1) / self._apart
        self._growth = np.maximum(self._growth, apart)
        covered = np.sqrt((self._between(frame.position, self._origin) ** 2).sum(axis=1))
        self._extent = np.maximum(self._extent, covered)
        speed = np.maximum(self._speeds(frame), self._speeds(fine))
        varying = frame.acceleration - np.array(self._maker.scene.gravity.uniform)
        self._pull = np.maximum(self._pull, np.sqrt((varying**2).sum(axis=1)) * frame.dt)
        pulled = np.sqrt((frame.acceleration**2).sum(axis=1)) * frame.dt
        self._speed = np.maximum(self._speed, np.maximum(speed, pulled))

    def _judge(self, before: Frame, frame: Frame, fine_before: Frame, fine: Frame, compared: BoolArray) -> bool:
        """Compare the states of the bodies; return whether a new window has to begin."""
        growth = np.maximum(self._growth, 1.0)
        speed = np.maximum(self._speed, AT_REST * float(self._speed.max()) + np.finfo(float).tiny)
        differences = {
            "position": (
                self._between(fine.position, frame.position),
                STATE * (self._radius + self._extent) + PULLED * self._pull * (frame.time - self._since),
                "m",
            ),
            "velocity": (fine.velocity - frame.velocity, STATE * speed + PULLED * self._pull, "m/s"),
        }
        if frame.angular_velocity is not None and fine.angular_velocity is not None:
            turned = (fine.angular_velocity - frame.angular_velocity) * self._radius[:, np.newaxis]
            differences["spin"] = (turned, STATE * speed + PULLED * self._pull, "m/s")
        suspects: dict[int, list[str]] = {}
        for name, (vectors, least, _) in differences.items():
            ratio = np.where(compared, np.sqrt((vectors**2).sum(axis=1)) / (least * growth), 0.0)
            if self._box is not None:  # the body may have crossed the border in one run only
                ratio = np.where(np.abs(vectors).max(axis=1) < self._box.min() / 4.0, ratio, 0.0)
            for body in np.flatnonzero(ratio > 1.0).tolist():
                suspects.setdefault(body, []).append(name)
            if not suspects:
                self._note(name, float(ratio.max(initial=0.0)), 1.0)
        if not suspects:
            self._waiting = None
            return False
        before, fine_before = self._waiting or (before, fine_before)
        look = self._look_closely(before, frame, fine_before)
        guilty: list[tuple[float, Moved]] = []
        waits, done = False, set[int]()
        for body, names in suspects.items():
            if body in done:
                continue
            touching = look.touching(body)
            # the impact is too near the instant, so the next instant decides
            if touching.last_impact > frame.time - frame.dt:
                waits = True
                done |= touching.bodies
                continue
            lacks = look.lacks_a_bounce(touching, fine)
            if not lacks and look.may_share_otherwise(touching, before, frame, fine):
                self.shared += 1
                done |= touching.bodies
                continue
            for name in names:
                vectors, least, unit = differences[name]
                lasts = frame.time - before.time if name == "position" else 1.0
                by, rubbed = touching.excess(vectors[body], lasts), touching.rubbed * lasts
                if name == "spin":
                    by, rubbed = float(np.sqrt((vectors[body] ** 2).sum())), SURFACE * rubbed
                allowed = (ROUGH if rubbed > 0.0 else 1.0) * float(least[body] * growth[body]) + rubbed
                allowed += touching.vague * self._changed(name, body, before, frame) * lasts
                if name == "position":
                    allowed += touching.depth
                self._note(name, by, allowed)
                if by > allowed or lacks:
                    values = self._size(name, body, frame), self._size(name, body, fine), by, allowed
                    met = look.impacts_of(body, self._names)
                    called = self._names.of(body)
                    moved = Moved(CALLED[name], before.time, frame.time, (body,), called, *values, unit, *met)
                    guilty.append((by / allowed, moved))
        if guilty:
            self._add(max(guilty, key=lambda each: each[0])[1])
        self._waiting = (before, fine_before) if waits and not guilty else None
        return bool(guilty) or not waits

    def _look_closely(self, before: Frame, frame: Frame, fine_before: Frame) -> CloseLook:
        """Repeat both runs between two instants, with their contacts; the run begins some steps earlier, for loads."""
        since = next((one for one in reversed(self._past) if one.step <= before.step - LASTS), before)
        states = zip(self._close_spaces(frame.dt), (since, fine_before), strict=True)
        span = before.time, frame.time, frame.dt
        run, refined = (look_closely(space, one, *span, self._maker.start) for space, one in states)
        return CloseLook(run, refined, self._maker.start)

    def _close_spaces(self, dt: float) -> tuple[Space, Space]:
        """Return spaces that record contacts: one with the run's steps, at first ``dt`` s, one with shorter steps."""
        if self._closely is None:
            max_dt = dt / self._factor if self._batches else None
            make = self._maker.space
            self._closely = make(contacts=True), make(1.0 / self._factor, contacts=True, max_dt=max_dt)
        return self._closely

    def _changed(self, name: str, body: int, before: Frame, frame: Frame) -> float:
        """Return the change of a body's velocity, or of the speed of its surface, between two frames, in m/s."""
        one, other, reach = before.velocity, frame.velocity, 1.0
        if name == "spin" and before.angular_velocity is not None and frame.angular_velocity is not None:
            one, other, reach = before.angular_velocity, frame.angular_velocity, float(self._radius[body])
        return reach * float(np.sqrt(((other[body] - one[body]) ** 2).sum()))

    def _size(self, name: str, body: int, frame: Frame) -> float:
        """Return the magnitude of the compared quantity: a distance in m, or a speed in m/s."""
        if name == "position":
            return float(np.sqrt((self._between(frame.position, self._origin)[body] ** 2).sum()))
        if name == "velocity":
            return float(np.sqrt((frame.velocity[body] ** 2).sum()))
        assert frame.angular_velocity is not None
        return float(np.sqrt((frame.angular_velocity[body] ** 2).sum()) * self._radius[body])

    def _judge_overlaps(self, before: Frame, frame: Frame, fine: Frame) -> None:
        one, other = frame.books.moments.overlap, fine.books.moments.overlap
        deep = 0.0 if one is None else one.value
        shallow = 0.0 if other is None else other.value
        self._note("overlap", abs(deep - shallow), OVERLAP)
        # the first overlap that differs
        if abs(deep - shallow) > OVERLAP and not any(each.observable == "overlap" for each in self.moved):
            worst = one if one is not None and deep > shallow else other
            assert worst is not None
            ends = tuple(worst.bodies)
            between, values = self._names.pair(ends), (deep, shallow, abs(deep - shallow), OVERLAP)
            self.moved.append(Moved("overlap", before.time, frame.time, ends, between, *values, ""))

    def _add(self, moved: Moved) -> None:
        """Add an observable, unless it has moved before."""
        if not any((each.observable, each.bodies) == (moved.observable, moved.bodies) for each in self.moved):
            self.moved.append(moved)

    def _note(self, name: str, by: float, allowed: float) -> None:
        self.largest[name] = max(self.largest.get(name, 0.0), by / allowed if allowed > 0.0 else 0.0)


def _booked(before: Frame, frame: Frame) -> FloatArray:
    """Return the energies (J) that the entries of the ledger received between two frames."""
    return _entries(frame.energy)[1] - _entries(before.energy)[1]


def _without_what_slips(differ: FloatArray) -> FloatArray:
    """Return differences of ledger entries without the energy that a wall or a flow gives to a sliding contact.

    Friction removes this energy at once, so none of it is left. Both entries depend only on the contact's load, and
    many contacts may share a load differently.
    """
    rest = differ.copy()
    for k in range(FORCES, CORRECTED % len(rest)):
        if rest[k] * rest[FRICTION] < 0.0:
            passed = math.copysign(min(abs(rest[k]), abs(rest[FRICTION])), rest[FRICTION])
            rest[FRICTION] -= passed
            rest[k] += passed
    return rest


def _entries(energy: Energy) -> tuple[tuple[str, ...], FloatArray]:
    """Return the names and the values of the entries of the ledger, in joules."""
    ledger = energy.ledger
    named = [("restitution", ledger.restitution), ("friction", ledger.friction), *ledger.forces]
    named.append(("stabilisation", ledger.stabilisation))
    return tuple(name for name, _ in named), np.array([value for _, value in named])
