"""A trial run, which advances up to the times at which positions are requested, while its share of the budget lasts.

The budget is an amount of work, not of time, so a promise has the same bits on any machine. Work is in nominal seconds:
the numbers of steps, iterations, held contacts and impacts in the trial runs, times their costs, which were measured on
one core of the machine in docs/performance.md. On a slower or busy machine, the actual time is longer, but the trial
runs end at the same step. A budget of actual time would give a scene different steps on fast and slow machines.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from copy import copy
from dataclasses import dataclass, field, replace

from carom.arrays import FloatArray
from carom.errors import PhysicsError
from carom.physics.forces.gravity.direct import MAX_IN_ONE_BLOCK
from carom.physics.simulation import Simulation
from carom.plan.auto import PAIRS_UP_TO, gravity_method, integrator
from carom.scene.load import Scene
from carom.scene.schema import Expect, Promise
from carom.scene.start import InitialBodies

LEAST = 0.2  # nominal s, smallest budget if nothing can touch, so that errors beyond the trial runs can be extrapolated
# Smallest number of leapfrog steps that the budget pays for, so that trial runs cover 8 samples of 4 steps; with more
# than about 400 bodies, this is more than `LEAST`.
LEAST_STEPS = 800
# Nominal s, smallest budget if bodies may touch, so that nothing is promised beyond the trial runs. 1 s covers
# `billiards` at 10⁻⁴, whose steps with friction take Python 0.5 ms each.
LEAST_OF_CONTACTS = 1.5
MOST_OF_LEAST = 5.0  # nominal s, upper limit of the smallest budget for many bodies that cannot touch
PART_OF_RUN = 0.1  # budget as a fraction of the nominal time of the run itself, if this is larger
MOST = 60.0  # nominal s, an upper limit, because chattering contacts could take infinitely many steps
# Nominal s, accurate to a factor of two: a call from Python, a step in a kernel, and the part of a body or contact in a
# step.
CALL, CALL_WITH_CONTACTS = 2e-5, 1e-4
KERNEL_STEP, KERNEL_BODY = 3e-7, 1e-8
TABLE_FORCES = 1.5e-5  # time that Python takes in a sum of forces for more bodies than `MAX_IN_ONE_BLOCK`
CONTACT_BODY = 5e-7  # cost of the search for the contacts and the next impacts of a body
# costs of held contacts; the last value is the cost of each contact and iteration
HELD_STEP, HELD_CONTACT, SWEEP = 4e-4, 1e-6, 4e-8
IMPACT = 1.4e-6
# costs of each end of a pair in a direct sum; the second value applies to few bodies, whose step examines each pair
PAIR, FEW_PAIR = 7e-10, 4e-9
# cost of a body in a tree with this opening angle; the number of boxes grows like 1/angle³
TREE_BODY, TREE_ANGLE = 1.2e-6, 0.5
RADAU_STEP, RADAU_BODY, RADAU_PAIR = 1e-6, 2.5e-7, 9e-9  # cost of an iteration of Gauss–Radau integration
ITERATIONS = 2.5  # iterations per step
ORBIT_STEP, ORBIT_BODY = 1e-7, 1e-7  # cost of a step of Wisdom–Holman integration
AT_ONCE = 0.05  # nominal s that a kernel takes between two checks of the budget
Watcher = Callable[["WorkBudget"], None]
NEVER = 2**62  # number of steps between two energy checks of a trial run, so large that no check occurs


@dataclass
class WorkBudget:
    """The allowed and the spent work of a look-ahead."""

    duration: float  # s, duration of the run
    least: float = LEAST_OF_CONTACTS  # nominal s, smallest budget
    part: float = 1.0  # this budget as a fraction of the whole budget of a look-ahead
    watch: Watcher | None = None  # called from time to time during trial runs
    own: float = 0.0  # nominal s, the work of the run itself, estimated from the latest trial run
    spent: float = 0.0  # nominal s
    reached: float = 0.0  # s, time of the present trial run
    covered: float = field(default=math.inf)  # s, time reached by all trial runs within the budget

    @property
    def total(self) -> float:
        """The whole budget, in nominal s."""
        return self.part * max(self.least, min(PART_OF_RUN * self.own, MOST))

    @property
    def left(self) -> float:
        """The remaining budget, in nominal s."""
        return max(0.0, self.total - self.spent)

    def spend(self, work: float, reached: float) -> None:
        """Add the work (nominal s) of a trial run that has reached a time (s)."""
        self.spent += work
        self.reached = reached
        if self.watch:
            self.watch(self)

    def cover(self, until: float) -> None:
        """Record that a trial run ended at a time (s) because its share of the budget was spent."""
        self.covered = min(self.covered, until)


def force_work(scene: Scene) -> float:
    """Return the nominal time (s) of a sum of all forces."""
    n, method = scene.count, gravity_method(scene)
    work = KERNEL_BODY * n
    if method == "none":
        return work
    work += 0.0 if n <= MAX_IN_ONE_BLOCK else TABLE_FORCES
    direct = (FEW_PAIR if n <= PAIRS_UP_TO else PAIR) * n * n
    if method == "direct":
        return work + direct
    return work + min(direct, TREE_BODY * n * (TREE_ANGLE / scene.gravity.opening_angle) ** 3)


def least_work(scene: Scene, touches: bool) -> float:
    """Return the smallest budget (nominal s) of a look-ahead."""
    steps = LEAST_STEPS * (KERNEL_STEP + force_work(scene))
    return LEAST_OF_CONTACTS if touches else min(max(LEAST, steps), MOST_OF_LEAST)


def radau_work(bodies: int) -> float:
    """Return the nominal time (s) of an iteration of a Gauss–Radau step."""
    return RADAU_STEP + RADAU_BODY * bodies + RADAU_PAIR * bodies * bodies


def step_work(scene: Scene) -> float:
    """Return the nominal time (s) of a step between contacts."""
    chosen = integrator(scene)
    if chosen.controls_error:
        return ITERATIONS * radau_work(scene.count)
    return KERNEL_STEP + len(chosen.substeps) * force_work(scene)


class TrialRun:
    """A run that advances only up to the times at which positions are requested, (K,) s in ascending order.

    It may spend a ``share`` of the whole budget. The actual run is estimated to take ``longer`` times the work of this
    run.
    """

    def __init__(
        self,
        scene: Scene,
        refinement: float,
        threads: int | None,
        start: InitialBodies,
        times: FloatArray,
        budget: WorkBudget | None = None,
        share: float = 1.0,
        longer: float = 1.0,
    ) -> None:
        promise = Promise(refinement=refinement, until=scene.time.duration, lyapunov=0.0, error=(0.0,))
        record = scene.record.model_copy(update={"check_every": NEVER})
        unchecked = scene.model_copy(update={"promise": promise, "record": record, "expect": Expect()})
        self.refinement = refinement
        self.rests_from = math.inf  # s, time from which contacts are at rest, which the integrator cannot hold
        self.times = times
        self.work = 0.0  # nominal s so far
        self.is_cut = False  # whether the run ended because its share of the budget was spent
        self.share = share
        self._budget, self._longer = budget or WorkBudget(scene.time.duration), longer
        self._simulation = Simulation(unchecked, start, threads)
        self._simulation.count_no_impacts()
        self._start = self._simulation.frame().checkpoint
        self._chooses_steps = integrator(scene).controls_error
        touches = self._simulation.requirements.contact.modelled
        self._call = CALL_WITH_CONTACTS + CONTACT_BODY * scene.count if touches else CALL
        self._each = step_work(scene)
        self._most = max(1, int(AT_ONCE / self._each))
        self._failed = False
        self._positions: list[FloatArray] = []  # (n, 3) m, positions at each of the times so far

    @property
    def known(self) -> int:
        """The number of times that are settled, because the run has reached them or has failed earlier."""
        return len(self._positions) if self.is_cut else len(self.times)

    @property
    def steps(self) -> int:
        """The number of steps so far."""
        return self._simulation.step

    @property
    def reached(self) -> float:
        """The time (s) after the last step."""
        return self._simulation.time

    def at(self, sample: int) -> FloatArray | None:
        """Return the positions at one of the times, (n, 3) m; None if the run failed or ended before."""
        while len(self._positions) <= sample and not (self._failed or self.is_cut):
            try:
                self._advance(float(self.times[len(self._positions)]))
            except PhysicsError:  # the step is too long
                self._failed = True
        return self._positions[sample] if sample < len(self._positions) else None

    def end(self) -> None:
        """End the run; the times that it has not yet reached remain unknown."""
        self.is_cut = True

    def again(self, start: InitialBodies) -> TrialRun:
        """Complete this run; then return a run from another initial state, which reuses the memory of this run."""
        self.at(len(self.times) - 1)
        other = copy(self)
        other.rests_from, other.work, other.is_cut, other._failed, other._positions = math.inf, 0.0, False, False, []
        self._simulation.restore(replace(self._start, position=start.position))
        return other

    def _advance(self, time: float) -> None:
        """Advance to a time (s) and store the positions there, unless the share of the budget is spent earlier."""
        simulation = self._simulation
        while simulation.time < time:
            if self.work > self.share * self._budget.total:
                self.is_cut = True
                self._note_rest(simulation.has_solution)
                return
            before = simulation.step
            simulation.approach(time, self._most, ends_there=not self._chooses_steps)
            self._spend(simulation.step - before)
        if not self._chooses_steps:
            self._positions.append(simulation.state.position.copy())
            return
        solution = simulation.between(time)
        self._note_rest(solution is not None)
        self._positions.append(simulation.state.position.copy() if solution is None else solution[0])

    def _note_rest(self, flies: bool) -> None:
        """Record the last of the times at which no contacts rest."""
        if self._chooses_steps and not flies and self.rests_from == math.inf:
            self.rests_from = float(self.times[len(self._positions) - 1]) if self._positions else 0.0

    def _spend(self, steps: int) -> None:
        """Record the work of the last call."""
        simulation, budget = self._simulation, self._budget
        contacts, sweeps, impacts = simulation.contact_work
        work = self._call + steps * self._each + impacts * IMPACT
        if contacts:
            held = 0.0 if simulation.has_solution else HELD_STEP
            work += held + contacts * (HELD_CONTACT + sweeps * SWEEP)
        self.work += work
        budget.own = self._longer * self.work * budget.duration / simulation.time
        budget.spend(work, simulation.time)
