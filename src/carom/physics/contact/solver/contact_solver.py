"""The contact solver, which runs the phases on the contacts of each step."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from carom.arrays import BoolArray, FloatArray, IntArray, RecordArray
from carom.physics.aligned import Buffer, columns
from carom.physics.bodies import Bodies
from carom.physics.contact.constraints import (
    ENOUGH,
    ENOUGH_AS_NEEDED,
    MIN_PER_TASK,
    SETTINGS,
    SHARED_FROM,
    ConstraintSystem,
)
from carom.physics.contact.geometry import update_geometry
from carom.physics.contact.graph import SolveOrder, solve_order_of
from carom.physics.contact.guided_walls import NO_PUSHES
from carom.physics.contact.islands import MOST_EXACT, Islands, mark_meshed
from carom.physics.contact.law import Materials
from carom.physics.contact.loads import UNKNOWN, add_loads, clear_loads, write_rest_speeds
from carom.physics.contact.records import ContactRecord, ContactStateRecord, ImpulseRecord, LoadRecord
from carom.physics.contact.solids import add_arc_speeds, add_load_of_walls
from carom.physics.contact.solver.body_state import active_bodies, gather, scatter
from carom.physics.contact.solver.impacts import CONVERGED, check_closing
from carom.physics.contact.solver.phase_code import IMPACTS, POSITIONS, RESTING, PhaseCode
from carom.physics.contact.solver.phases import MAX_MESHED_ITERATIONS, SOLVED, work
from carom.physics.contact.solver.positions import (
    audit_corrections,
    count_contacts,
    find_push_fractions,
    gather_positions,
    scatter_positions,
)
from carom.physics.contact.solver.prepare import ImpulseCache, begin_contacts, impulses_of, mark_pressed
from carom.physics.contact.solver.workspace import Workspace
from carom.physics.contact.statistics import ContactStatistics
from carom.physics.diagnostics.ledger import terms_of
from carom.physics.jit.decorators import entry_of, kernel
from carom.physics.jit.team import ALONE, Team
from carom.scene.schema.contact import Sweeps
from carom.scene.start import HalfSpaces

# With these values of `contact.sweeps`, conjugate gradients follow the iterations. A round of conjugate gradients ends
# when r·z has fallen to this fraction of its first value. A more exact solution would gain nothing, because the round
# then releases contacts, which changes the equations. In a falling heap of 1000 (benchmarks/heap.py), a fraction of 0.3
# takes a fifth of the iterations that 10⁻³ takes, and leaves the same overlaps.
SOLVED_BY_SWEEPS: dict[Sweeps | int, float] = {"auto": 0.3, "converged": SOLVED, "as-needed": SOLVED}
# values of `contact.sweeps` for which small changes end the iterations
AS_NEEDED: tuple[Sweeps, ...] = ("as-needed", "quick")
CONTACTS_PER_BODY = 8  # typical upper limit of contacts per body of an island


# Number of iterations for each word that `contact.sweeps` accepts. With "quick", a step of a falling heap takes 1.24 ms
# with four iterations and 1.36 ms with five. With three iterations, it takes 1.32 ms, and overlaps are four times as
# deep after 3 s (benchmarks/heap.py, 1000 spheres).
MOST_SWEEPS: dict[Sweeps, int] = {"auto": 8, "converged": 8, "as-needed": 8, "quick": 4}


class ContactSolver:
    """Finds the impulses of the contacts of each step.

    Parameters
    ----------
    bodies, planes
        The possible ends of a contact.
    materials
        Coefficients of the contact law.
    box
        Size of the periodic box, (3,) m; zeros in open space; or the record of a sheared box.
    friction
        Whether impulses exert torques.
    team
        Threads that share the work.
    records
        Whether to keep the impulses of impacts, in `recorded`.
    sweeps
        `contact.sweeps` of the scene: whether small changes end the iterations, and whether conjugate gradients follow.

    Attributes
    ----------
    code
        The machine code of the phases.
    """

    def __init__(
        self,
        bodies: Bodies,
        planes: HalfSpaces,
        materials: Materials,
        box: FloatArray,
        friction: bool,
        team: Team,
        records: bool = False,
        sweeps: Sweeps | int = "auto",
    ) -> None:
        self._bodies = bodies
        self._planes = planes
        self._box = box
        self._spin = bodies.ends.angular_velocity if friction else bodies.ends.angular_velocity[:0]
        self._team = team
        self._workspace = Workspace(bodies, planes, materials, box, self._spin, records)
        self._normals = Buffer(columns=3)
        self._islands = Islands(len(bodies.ends.velocity), team)
        # (n + p, 3) m/s², accelerations that press contacts together
        self.pressing = np.zeros_like(bodies.ends.acceleration) if planes.press_alone else bodies.ends.acceleration
        self.turning = 0.0  # 1/s, largest turning rate of a normal; computed only if walls alone press
        self.order = solve_order_of(np.zeros((0, 2), dtype=np.int64), np.zeros(0, dtype=np.int64))
        self._active = np.zeros(0, dtype=np.int64)  # bodies and planes with a contact
        self._loaded = self._active  # bodies and planes that may carry a load
        self._counts: IntArray | None = None  # (n + p,) number of contacts of each end; None until needed
        self._settings = np.zeros(1, SETTINGS)
        self._settings["spins"] = friction
        self._settings["refines"] = sweeps in SOLVED_BY_SWEEPS
        self._settings["solved"] = SOLVED_BY_SWEEPS.get(sweeps, 0.0)
        self._settings["meshed_iterations"] = MAX_MESHED_ITERATIONS if sweeps == "auto" else 0
        self._enough = np.zeros(0)
        self._default_enough = ENOUGH_AS_NEEDED if sweeps in AS_NEEDED else ENOUGH
        # with "auto", small changes end the iterations in meshed islands only
        self._finds_meshed = sweeps == "auto" and len(bodies) > MOST_EXACT // CONTACTS_PER_BODY
        ends = len(bodies.ends.velocity) if self._finds_meshed else 0
        self._tree, self._members = np.empty(ends, dtype=np.int64), np.empty((ends, 2), dtype=np.int64)
        alternates = bool((materials.rows["kinetic_friction"] < materials.rows["static_friction"]).any())
        self._settings["keeps_iterating"] = sweeps in ("auto", "converged") or alternates
        self._settings["spares_meshed"] = not alternates
        self._settings["slides_meshed"] = alternates and sweeps == "auto"
        self.code = PhaseCode(friction)
        self._run: Callable[..., int] | None = None  # `work`, compiled for this solver's systems

    def lay(self, order: SolveOrder, keep: RecordArray[ContactRecord] | None = None, rounding: float = 0.0) -> None:
        """Begin a step: lay out the records of its contacts, and compute their geometry.

        Parameters
        ----------
        order
            The contacts in the order of solving.
        keep
            `contacts` of an earlier step, not to be overwritten.
        rounding
            m, rounding of the coordinates; a pair with a gap up to this touches.
        """
        if order is not self.order:
            self._active = active_bodies(order.pairs, len(self._bodies.ends.velocity))
            self._counts = None
            self._enough = np.full(len(order.pairs), self._default_enough)
            if self._finds_meshed:
                joined = order.pairs, self._active, self._bodies.ends.inverse_mass
                mark_meshed(*joined, self._tree, self._members, self._enough)
        self.order = order
        self._settings["independent"], self._settings["islands_known"] = order.independent, False
        self._system = self._workspace.system(order, self._active, self._enough, self._settings, keep)
        self.found_normals = self._normals.take(len(order.pairs))
        begun = *self._geometry(), rounding, self.found_normals
        self._team.divide(len(order.pairs), MIN_PER_TASK, begin_contacts, *begun)

    @property
    def system(self) -> ConstraintSystem:
        """The contacts of the step with all data that the phases need; the next step may use other memory."""
        return self._system

    @property
    def counts(self) -> IntArray:
        """(n + p,) number of contacts of each body and plane."""
        if self._counts is None:
            self._counts = np.empty(len(self._bodies.ends.inverse_mass), dtype=np.int64)
            count_contacts(self._system.pairs, self._counts)
        return self._counts

    @property
    def contacts(self) -> RecordArray[ContactRecord]:
        """Records, (m,) `CONTACT`, in the order of solving; the properties below have the same order."""
        return self._system.contacts

    @property
    def states(self) -> RecordArray[ContactStateRecord]:
        """(m,) `CONTACT_STATE`."""
        return self._system.states

    @property
    def recorded(self) -> RecordArray[ImpulseRecord]:
        """(m,) `RECORDED`; empty unless contacts are recorded."""
        return self._system.recorded

    @property
    def normals(self) -> FloatArray:
        """Normals from i to j, (m, 3)."""
        return columns(self._system.contacts, ("nx", "ny", "nz"))

    @property
    def arms(self) -> FloatArray:
        """Lever arms, (m, 2) m, from each end's centre to the contact point."""
        return columns(self._system.contacts, ("arm_i", "arm_j"))

    @property
    def impulses(self) -> FloatArray:
        """Impulses λ_n and λ_t, (m, 4) N s."""
        return impulses_of(self._system.contacts)

    @property
    def overlaps(self) -> FloatArray:
        """Overlaps, (m,) m; the overlap is negative for a gap."""
        return self._system.states["overlap"]

    @property
    def rest_speed(self) -> FloatArray:
        """Rest speeds, (m,) m/s; a contact that closes no faster than its rest speed does not bounce."""
        return self._system.states["rest_speed"]

    @property
    def load_speed(self) -> FloatArray:
        """Load speeds, (m,) m/s: the largest acceleration in each contact's island, times the step."""
        return self._system.load_speed

    def speeds_by_pair(self) -> tuple[FloatArray, FloatArray]:
        """Return copies of `rest_speed` and `load_speed` in the order of the pairs, (m,) m/s."""
        speeds = np.empty((2, len(self.order.place)))
        _gather_speeds(self.order.place, self._system.states, self._system.load_speed, speeds)
        return speeds[0], speeds[1]

    @property
    def approach(self) -> FloatArray:
        """Largest closing speed of each contact in the iterations of this step, (m,) m/s."""
        return self._system.states["approach_speed"]

    @property
    def ledger(self) -> FloatArray:
        """Energies of each contact, (m, 3) J: losses by restitution and by friction, gain by stabilisation."""
        return terms_of(self._system.states)

    @property
    def audited(self) -> FloatArray:
        """Energies of `ledger` in the last `hold`, summed over each piece, (k, 3) J."""
        return terms_of(self._system.piece_results)

    def statistics(self) -> ContactStatistics:
        """Count the contacts that touched or carry an impulse, and sum their energies."""
        return ContactStatistics.of(
            self._system.pairs, self._system.contacts, self._system.states, self._bodies.ends, self._team
        )

    def compile_phases(self) -> None:
        """Compile the phases of `hold` without running them."""
        self.code.compile_ahead(RESTING, self._system)

    def update_geometry(self) -> None:
        """Update the geometry of the contacts to the present positions."""
        self._team.divide(len(self._system.pairs), MIN_PER_TASK, update_geometry, *self._geometry())

    def find_rest_speeds(self, field: FloatArray, dt: float) -> bool:
        """Compute load speeds and rest speeds (see `Islands`, `loads`); return whether any load speed is not 0."""
        ends, system, team, m = self._bodies.ends, self._system, self._team, len(self._system.pairs)
        self.find_pressing()
        accelerated = (self.pressing, ends.inverse_mass, field, dt)
        presses = self._islands.write_load_speeds(system.pairs, system.active, *accelerated, system.load_speed)
        pressed = ends.velocity, self.pressing, system.loads, dt
        speeds = system.load_speed, system.states
        team.divide(m, MIN_PER_TASK, write_rest_speeds, system.pairs, system.contacts, pressed, *speeds)
        if presses and self._planes.curves:
            moving = system.position, ends.velocity, system.surface, dt
            team.divide(m, MIN_PER_TASK, add_arc_speeds, system.pairs, moving, *speeds)
        return presses

    def find_pressing(self) -> None:
        """Compute the accelerations by which walls press bodies, in scenes where nothing else presses them."""
        ends, system, lift = self._bodies.ends, self._system, self._planes.largest_acceleration
        if self._planes.press_alone:
            self.pressing[:] = ends.acceleration
            near = system.pairs, system.position, ends.velocity, system.surface
            self.turning = add_load_of_walls(*near, lift, self.pressing)

    def correct_positions(self, max_iterations: int, next_kick: float = 0.0) -> FloatArray:
        """Correct the overlaps of resting contacts; return the displacements of the guided walls, (k,) m.

        ``next_kick`` is the length of the kick that follows, in s.
        """
        self._settings["next_kick"] = next_kick
        system, counts = self._system, self.counts
        team, bodies, active, ends = self._team, self._bodies, system.active, self._bodies.ends
        team.divide(len(system.pairs), MIN_PER_TASK, find_push_fractions, system.pairs, counts, system.states)
        moving = bodies.position, ends.velocity
        gathered = (*moving, ends.radius, ends.inverse_mass), system.pushed, system.pushed_in
        guided = self._planes.guided
        if guided:  # done even if nothing touches a guided wall, since all displacements are returned
            for axis in ("x", "y", "z"):
                system.pushed[axis][len(bodies) + guided.rows] = 0.0
        team.divide(len(active), MIN_PER_TASK, gather_positions, active, *gathered)
        self._work(POSITIONS, system, max_iterations)
        if guided:  # planes have no position
            active = active[: np.searchsorted(active, len(bodies))]
        team.divide(len(active), MIN_PER_TASK, scatter_positions, active, system.pushed, system.pushed_in, *moving)
        if not guided:
            return NO_PUSHES
        pushed = system.pushed[len(bodies) + guided.rows]
        return np.asarray(sum(pushed[axis] * along for axis, along in zip("xyz", guided.normals.T, strict=True)))

    def audit_corrections(self) -> None:
        """Book the work of the position correction, at the accelerations after it."""
        ends, system = self._bodies.ends, self._system
        pushed = (system.pairs, ends.acceleration, ends.inverse_mass, system.states)
        self._team.divide(len(system.pairs), MIN_PER_TASK, audit_corrections, *pushed)

    def resolve_impacts(self, bias_rate: float, max_iterations: int, impacts_only: bool) -> int:
        """Resolve the contacts that close; return the number of iterations.

        Parameters
        ----------
        bias_rate
            1/s, Baumgarte's separation speed per overlap; 0 for none.
        max_iterations
            Largest number of iterations, if they do not converge before.
        impacts_only
            Whether to skip resting contacts.
        """
        self._settings["bias_rate"] = bias_rate
        self._settings["impacts_only"] = impacts_only
        return self._lead(IMPACTS, self._system, max_iterations)

    @property
    def pressed(self) -> BoolArray:
        """Whether contacts have pressed each body since the last step, (n + p,); other bodies meet in impacts."""
        return self._workspace.pressed

    def mark_pressed(self, cache: ImpulseCache) -> None:
        """Mark the bodies that impulses press."""
        held = cache.pairs, cache.place, cache.contacts
        self._team.divide(
            len(cache.pairs), MIN_PER_TASK, mark_pressed, *held, self._bodies.ends.inverse_mass, self.pressed
        )

    @property
    def loads(self) -> RecordArray[LoadRecord]:
        """(n + p,) `LOAD`, loads by the contacts held before the drift."""
        return self._workspace.loads

    def assume_loads(self) -> None:
        """Assume that all bodies are loaded in all directions, since no stored impulses show their loads."""
        for axis in ("xx", "yy", "zz"):
            self.loads[axis][: len(self._bodies)] = UNKNOWN

    def find_loads(self, kick: float) -> None:
        """Find the loads of all bodies from the impulses of a kick (s); a kick of 0 means that no contact is held."""
        clear_loads(self._loaded, self.loads)
        self._loaded = self._active if kick > 0.0 else self._active[:0]
        if kick > 0.0:
            system = self._system
            add_loads(system.pairs, system.contacts, self._bodies.ends.inverse_mass, kick, self.loads)

    @property
    def any_rests(self) -> bool:
        """Whether a contact was at rest when impacts were last resolved."""
        return bool(self._settings["any_rests"][0])

    def hold(
        self,
        dt: float,
        booked: float,
        drift: float,
        bias_rate: float,
        max_iterations: int,
        against: FloatArray | None = None,
    ) -> int:
        """Find the impulses of resting contacts after a kick; return the number of iterations.

        The iterations start from the impulses in `contacts`.

        Parameters
        ----------
        dt
            s, the step for which the rest speeds were computed; before a drift, the previous step.
        booked
            s, the part of the drift for which the work of the forces is already booked: the length of the kick, unless
            there is drag.
        drift
            s, length of the drift that follows; 0 after the last kick.
        bias_rate
            1/s, Baumgarte's separation speed per overlap.
        max_iterations
            Largest number of iterations, if they do not converge before.
        against
            (n + p, 3) m/s², accelerations that the contacts counteract (default: the bodies' accelerations).
        """
        settings = self._settings
        settings["dt"], settings["booked"], settings["drift"] = dt, booked, drift
        settings["bias_rate"] = bias_rate
        system = self._system
        if against is not None:
            system = system._replace(acceleration=np.ascontiguousarray(against))
        return self._lead(RESTING, system, max_iterations)

    def is_closing(self, dt: float) -> bool:
        """Return whether a contact still closes too fast after the iterations of a step of dt s."""
        system, closing = self._system, np.zeros(1, dtype=np.bool_)
        contacts = system.pairs, (system.contacts, system.states, system.load_speed), self._bodies.ends.velocity
        negligible = CONVERGED * float(self._settings["fastest"][0])
        self._team.divide(len(system.pairs), MIN_PER_TASK, check_closing, *contacts, (negligible, dt), closing)
        return bool(closing[0])

    def _geometry(self) -> tuple[object, ...]:
        bodies, planes, system = self._bodies, self._planes, self._system
        shapes = bodies.position, bodies.radius, self._box, planes.surface, planes.offset
        return system.pairs, shapes, system.contacts, system.states

    def _lead(self, job: int, system: ConstraintSystem, max_iterations: int) -> int:
        """Run a job on the velocities of the active bodies; return the number of iterations."""
        ends, team, b = self._bodies.ends, self._team, len(system.active)
        gathered = (ends.velocity, self._spin, ends.inverse_mass, ends.inverse_inertia, system.bodies)
        team.divide(b, MIN_PER_TASK, gather, system.active, *gathered)
        iterations = self._work(job, system, max_iterations)
        team.divide(b, MIN_PER_TASK, scatter, system.active, system.bodies, ends.velocity, self._spin)
        return iterations

    def _work(self, job: int, system: ConstraintSystem, max_iterations: int) -> int:
        """Run a job, with the team if there are many contacts; return the number of iterations."""
        self.code.require(job, system)
        asked = job, self.code.addresses, self.code.kind, system, max_iterations
        run = self._run = self._run or entry_of(work, ALONE, *asked)
        if len(system.pairs) < SHARED_FROM:
            return run(ALONE, *asked)
        with self._team.leading() as board:
            return run(board, *asked)


@kernel
def _gather_speeds(
    place: IntArray, states: RecordArray[ContactStateRecord], load_speed: FloatArray, speeds: FloatArray
) -> None:
    for c in range(len(place)):
        speeds[0, c], speeds[1, c] = states[place[c]].rest_speed, load_speed[place[c]]
