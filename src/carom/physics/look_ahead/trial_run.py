"""A run ahead, which advances only as far as its positions are asked for."""

from __future__ import annotations

import math
from copy import copy
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from carom.physics.error import PhysicsError
from carom.physics.simulation import Simulation
from carom.plan.auto import integrator
from carom.scene.schema import Expect, Promise, Scene
from carom.scene.start import Start

FloatArray = NDArray[np.float64]

NEVER = 2**62  # steps between two checks of the energy of a run ahead
BODIES_PER_STEP = 30  # a step has a fixed cost of about as many bodies
BODIES_PER_HELD_STEP = 300  # likewise where contacts are held
# Steps with held contacts at most, for a refinement of 1. They end at impacts, which never cease in a heap that
# chatters. Bundled scenes take up to 5000 where a run ahead is of use.
MOST_HELD = 10_000.0


class TrialRun:
    """A run that advances only as far as its positions are asked for."""

    def __init__(self, scene: Scene, refinement: float, threads: int | None, start: Start, times: FloatArray) -> None:
        promise = Promise(refinement=refinement, until=scene.time.duration, lyapunov=0.0, error=(0.0,))
        record = scene.record.model_copy(update={"check_every": NEVER})
        unchecked = scene.model_copy(update={"promise": promise, "record": record, "expect": Expect()})
        self.refinement = refinement
        self.rests_from = math.inf  # s; contacts that the integrator does not hold itself come to rest after that
        self._simulation = Simulation(unchecked, start, threads)
        self._simulation.count_no_impacts()
        self._start = self._simulation.frame().checkpoint
        self._chooses_steps = integrator(scene).controls_error
        self._ended = False  # it failed or was given up
        self._held = 0.0  # steps with held contacts
        self._most_held = MOST_HELD * max(1.0, refinement)
        self.times = times
        self._positions: list[FloatArray] = []  # (n, 3) m, at the times so far

    @property
    def work(self) -> float:
        """Cost of all its steps, extrapolated from those so far; a step costs its bodies and a fixed number more.

        Steps of a free flight, which one kernel takes, cost as much as one body at most.
        """
        steps = self._simulation.step * len(self.times) / max(len(self._positions), 1)
        if self._simulation.is_free_flight:
            return steps
        more = BODIES_PER_STEP if self.rests_from == math.inf else BODIES_PER_HELD_STEP
        return steps * (self._simulation.scene.count + more)

    def at(self, sample: int) -> FloatArray | None:
        """Return the positions at one of the times, (n, 3) m; None where it fails or is given up before."""
        while len(self._positions) <= sample and not self._ended:
            try:
                found = self._next(float(self.times[len(self._positions)]))
            except PhysicsError:  # the step is too long
                self._ended = True
            else:
                self._ended = self.is_given_up
                if not self._ended:
                    self._positions.append(found)
        return self._positions[sample] if sample < len(self._positions) else None

    @property
    def is_given_up(self) -> bool:
        """Whether held contacts have taken all the steps that a run ahead is worth."""
        return self._held >= self._most_held

    def again(self, start: Start) -> TrialRun:
        """Complete this run, then return one from another start that reuses its memory."""
        self.at(len(self.times) - 1)
        other = copy(self)
        other.rests_from, other._held, other._ended, other._positions = math.inf, 0.0, False, []
        self._simulation.restore(replace(self._start, position=start.position))
        return other

    def _next(self, time: float) -> FloatArray:
        """Advance to a time in s; return the positions there, (n, 3) m."""
        simulation = self._simulation
        if not self._chooses_steps:
            simulation.reach(time)
            return simulation.state.position.copy()
        self._held += simulation.pass_by(time, self._most_held - self._held)
        solution = simulation.between(time)
        if solution is not None:
            return solution[0]
        if self.rests_from == math.inf:  # since the last time at which they did not rest, or soon after
            self.rests_from = float(self.times[len(self._positions) - 1]) if self._positions else 0.0
        return simulation.state.position.copy()
