"""Steps of integrators that choose them and take many per call, up to the next check or frame."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from carom.physics.checkpoint import Checkpoint
from carom.physics.diagnostics.bookkeeper import Bookkeeper
from carom.physics.diagnostics.finite import refuse_infinities
from carom.physics.integrators.batch import BatchIntegrator
from carom.physics.integrators.checkpoint import IntegratorCheckpoint
from carom.physics.rotation import rotate
from carom.physics.schedule import quiet
from carom.physics.stepper import Goal
from carom.physics.time_step import Timestep
from carom.physics.world import World

FloatArray = NDArray[np.float64]


class BatchStepper:
    """Advances a world without contacts by a `BatchIntegrator`; see `Stepper`.

    Parameters
    ----------
    world, books
        What is advanced, and its books.
    integrator
        Takes the steps.
    timestep
        Suggests the first one.
    """

    def __init__(self, world: World, books: Bookkeeper, integrator: BatchIntegrator, timestep: Timestep) -> None:
        self._world = world
        self._books = books
        self._integrator = integrator
        self.timestep = timestep

    @property
    def previous_dt(self) -> float:
        """The step in s that the integrator would take next."""
        return self._integrator.next_dt

    @property
    def checkpoint(self) -> IntegratorCheckpoint:
        """A copy of the integrator's state besides the bodies."""
        return self._integrator.checkpoint

    @property
    def first_dt(self) -> float:
        """The step in s that the limits of the scene allow in the present state."""
        return self.timestep.first(self._world.bodies)

    def warm_up(self, dt: float) -> None:
        """Take a step of about dt seconds."""
        self._integrator.begin(dt)
        self._integrator.advance(0.0, dt, np.inf, 1)

    def begin(self) -> None:
        """Begin at the present positions and velocities."""
        self._integrator.begin(self.first_dt)

    def restore(self, checkpoint: Checkpoint) -> None:
        """Continue from a checkpoint."""
        self._integrator.restore(checkpoint.integrator, checkpoint.previous_dt)

    def advance(self, goal: Goal, checked: bool) -> bool:
        """Advance up to the goal or the next check; return whether a frame is due."""
        world, clock, bodies = self._world, self._world.clock, self._world.bodies
        every, turns = world.scene.record.check_every, world.needs.orientation.modelled
        steps, until = quiet(goal.schedule, clock.step, clock.time)
        most = 1 if turns else int(min(goal.most, steps, every - clock.step % every))
        batch = self._integrator.advance(clock.time, goal.end, until, most)
        clock.advance(*batch)
        refuse_infinities(bodies, world.names.bodies, clock.step, clock.time)
        if turns:
            rotate(bodies.orientation, bodies.angular_velocity, clock.dt, world.team)
        clock.foresee("error" if clock.limit == "end" else clock.limit, batch.steps)  # the end is not the scene's limit
        world.profile.mark("integrate")
        due = goal.is_reached(clock)
        checked = checked or due or clock.step % every == 0
        self._books.finish_step(world.forces.accelerate(potential=checked), checked)
        return due

    def between(self, earlier: float) -> tuple[FloatArray, FloatArray]:
        """Return positions and velocities, (n, 3) m and m/s, at a time in s before the end of the last step."""
        return self._integrator.at(earlier)
