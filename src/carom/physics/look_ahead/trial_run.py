"""A run ahead, which advances only as far as its positions are asked for and its share of the budget lasts."""

from __future__ import annotations

import math
from copy import copy
from dataclasses import replace

from carom.arrays import FloatArray
from carom.errors import PhysicsError
from carom.physics.look_ahead.budget import (
    AT_ONCE,
    CALL,
    CALL_WITH_CONTACTS,
    CONTACT_BODY,
    HELD_CONTACT,
    HELD_STEP,
    IMPACT,
    ITERATIONS,
    KERNEL_STEP,
    SWEEP,
    Budget,
    force_work,
    radau_work,
)
from carom.physics.simulation import Simulation
from carom.plan.auto import integrator
from carom.scene.schema import Expect, Promise, Scene
from carom.scene.start import InitialBodies

NEVER = 2**62  # steps between two checks of the energy of a run ahead


class TrialRun:
    """A run that advances only as far as its positions are asked for.

    Parameters
    ----------
    times
        (K,) s, in order.
    budget
        Gets the work of the run; the work of the run itself is taken to be ``longer`` times as much.
    share
        Of the whole budget, that this run may spend.
    """

    def __init__(
        self,
        scene: Scene,
        refinement: float,
        threads: int | None,
        start: InitialBodies,
        times: FloatArray,
        budget: Budget | None = None,
        share: float = 1.0,
        longer: float = 1.0,
    ) -> None:
        promise = Promise(refinement=refinement, until=scene.time.duration, lyapunov=0.0, error=(0.0,))
        record = scene.record.model_copy(update={"check_every": NEVER})
        unchecked = scene.model_copy(update={"promise": promise, "record": record, "expect": Expect()})
        self.refinement = refinement
        self.rests_from = math.inf  # s; contacts that the integrator does not hold itself come to rest after that
        self.times = times
        self.work = 0.0  # nominal s so far
        self.is_cut = False  # whether its share of the budget ended it
        self.share = share
        self._budget, self._longer = budget or Budget(scene.time.duration), longer
        self._simulation = Simulation(unchecked, start, threads)
        self._simulation.count_no_impacts()
        self._start = self._simulation.frame().checkpoint
        self._chooses_steps = integrator(scene).controls_error
        touches = self._simulation.requirements.contact.modelled
        self._call = CALL_WITH_CONTACTS + CONTACT_BODY * scene.count if touches else CALL
        evaluations = len(integrator(scene).substeps) or 1
        by_radau = ITERATIONS * radau_work(scene.count)
        self._each = by_radau if self._chooses_steps else KERNEL_STEP + evaluations * force_work(scene)
        self._most = max(1, int(AT_ONCE / self._each))
        self._failed = False
        self._positions: list[FloatArray] = []  # (n, 3) m, at the times so far

    @property
    def known(self) -> int:
        """The number of times at which the positions are known, or are known not to exist."""
        return len(self._positions) if self.is_cut else len(self.times)

    @property
    def steps(self) -> int:
        """The number of steps so far."""
        return self._simulation.step

    @property
    def reached(self) -> float:
        """The time in s after the last step."""
        return self._simulation.time

    def at(self, sample: int) -> FloatArray | None:
        """Return the positions at one of the times, (n, 3) m; None where it fails or is cut before."""
        while len(self._positions) <= sample and not (self._failed or self.is_cut):
            try:
                self._advance(float(self.times[len(self._positions)]))
            except PhysicsError:  # the step is too long
                self._failed = True
        return self._positions[sample] if sample < len(self._positions) else None

    def again(self, start: InitialBodies) -> TrialRun:
        """Complete this run, then return one from another start that reuses its memory."""
        self.at(len(self.times) - 1)
        other = copy(self)
        other.rests_from, other.work, other.is_cut, other._failed, other._positions = math.inf, 0.0, False, False, []
        self._simulation.restore(replace(self._start, position=start.position))
        return other

    def _advance(self, time: float) -> None:
        """Advance to a time in s, and keep the positions there, unless the share of the budget ends before."""
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
        """Note that contacts rest since the last time at which they did not, or soon after."""
        if self._chooses_steps and not flies and self.rests_from == math.inf:
            self.rests_from = float(self.times[len(self._positions) - 1]) if self._positions else 0.0

    def _spend(self, steps: int) -> None:
        """Note the work of the last call."""
        simulation, budget = self._simulation, self._budget
        contacts, sweeps, impacts = simulation.contact_work
        work = self._call + steps * self._each + impacts * IMPACT
        if contacts:
            held = 0.0 if simulation.has_solution else HELD_STEP
            work += held + contacts * (HELD_CONTACT + sweeps * SWEEP)
        self.work += work
        budget.own = self._longer * self.work * budget.duration / simulation.time
        budget.spend(work, simulation.time)
