"""The warm-up: a few tiny steps before a run."""

from __future__ import annotations

from carom.physics.forces.force import Potentials
from carom.physics.stepper import Stepper
from carom.physics.world import World

WARM_UP_DT = 1e-3  # of the step that the limits allow at the start


def warm_up(world: World, stepper: Stepper) -> Potentials:
    """Take a few tiny steps, then restore the state: frame 0 is the scene as written.

    They compute the accelerations for the first adaptive step, and compile the kernels. Returns the potential energies
    in J.
    """
    bodies = world.bodies
    moved = (bodies.position, bodies.velocity, bodies.orientation, bodies.angular_velocity)
    changing = (*moved, bodies.torque, bodies.angular_acceleration)
    saved = [array.copy() for array in changing]
    world.forces.accelerate(potential=False)
    stepper.warm_up(WARM_UP_DT * stepper.first_dt)
    for array, value in zip(changing, saved, strict=True):
        array[:] = value
    potentials = world.forces.accelerate(potential=True)
    stepper.begin()
    return potentials
