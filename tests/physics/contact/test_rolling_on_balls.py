"""Balls that roll on balls and spin about the normal, against the equations of rolling without slip."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from carom import Scene, Space
from carom.arrays import FloatArray
from rolling_balls import EXACT, on_sphere, rolling_without_slip

R, r = 1.0, 0.1  # m, of the ball below and of the rolling ball
G = np.array([0.0, 0.0, -9.81])  # m/s²
ROUGH = {"restitution": 0.0, "static_friction": 20.0, "kinetic_friction": 20.0}
DURATION = 0.5  # s


def ended(balls: list[dict[str, Any]], gravity: dict[str, Any], **time: Any) -> tuple[Space, float]:
    """Return a space at the end of a run, and the scale of the energy in J."""
    document = {"contact": ROUGH, "gravity": gravity, "body": balls, "time": {"duration": DURATION} | time}
    space = Space(Scene.from_dict(document))
    scales = [frame.energy.scale for frame in space.run()]
    return space, scales[-1]


def test_a_top_on_a_ball_precesses_as_the_equations_say() -> None:
    # a ball that spins with 300 rad/s does not roll off the top of another; before, its angle was 6 % too large
    polar, spin = 0.1, 300.0
    N = np.array([math.sin(polar), 0.0, math.cos(polar)])
    spins, position, velocity = rolling_without_slip(on_sphere(R + r), (R + r) * N, np.zeros(3), spin, r, G, DURATION)
    top = {"radius": r, "mass": 1.0, "position": ((R + r) * N).tolist(), "angular_velocity": spins.tolist()}
    balls = [top, {"radius": R, "position": [0.0, 0.0, 0.0], "fixed": True}]
    errors = []
    for dt in (2e-3, 1e-3):
        space, _ = ended(balls, {"constant": 0.0, "uniform": G.tolist()}, fixed_dt=dt)
        state = space.state
        errors.append([np.abs(state.position[0] - position).max(), np.abs(state.velocity[0] - velocity).max()])
    assert np.array(errors[0]) / np.array(errors[1]) == pytest.approx(4.0, rel=0.1)
    assert errors[1][0] < 1e-4 * r
    space, _ = ended(balls, {"constant": 0.0, "uniform": G.tolist()})
    assert abs(space.ledger.friction) < 1e-6 * 180.0  # J, of the spin; before, 0.01 J


def rolled(v: FloatArray, spins: FloatArray, mass: FloatArray, radius: FloatArray) -> FloatArray:
    """Return the separation (m) of two free balls after `DURATION`, which touch and do not slip.

    They start apart along x, with the relative velocity v (m/s) and the spins (2, 3) in rad/s. The constraint is
    v = w × n, with w = ρ_1 ω_1 + ρ_2 ω_2, and friction is the impulse f on the second one that keeps it.
    """
    inertia, distance = 0.4 * mass * radius**2, radius.sum()
    inverse = (1.0 / mass).sum()
    stopping = inverse + (radius**2 / inertia).sum()

    def rates(_: float, state: FloatArray) -> FloatArray:
        d, v, *spins = state.reshape(4, 3)
        n, turn = d / distance, v / distance
        change = np.cross(radius[0] * spins[0] + radius[1] * spins[1], turn)
        f = (change - (change @ n) * n) / stopping
        turned = [radius[k] / inertia[k] * np.cross(f, n) for k in range(2)]
        return np.concatenate((v, inverse * f - (v @ turn) * n, *turned))

    start = np.concatenate(([distance, 0.0, 0.0], v, *spins))
    return np.asarray(solve_ivp(rates, (0.0, DURATION), start, **EXACT).y[:3, -1])


def test_two_free_balls_that_attract_each_other_roll_about_each_other_without_work_of_friction() -> None:
    mass, radius, v = np.array([2.0, 1.0]), np.array([0.2, 0.1]), np.array([0.0, 1.0, 0.0])
    about = 20.0  # rad/s, about the normal
    w = np.array([0.0, 0.0, 1.0])  # w × n = v for n along x, shared by the two balls
    spins = np.array([[about, 0.0, 0.0], [-0.5 * about, 0.0, 0.0]]) + w / radius.sum()
    exact = rolled(v, spins, mass, radius)
    share = mass[::-1] / mass.sum() * np.array([-1.0, 1.0])  # so that the centre of mass stays at rest
    balls = [
        {
            "radius": radius[k],
            "mass": mass[k],
            "position": [share[k] * radius.sum(), 0.0, 0.0],
            "velocity": (share[k] * v).tolist(),
            "angular_velocity": spins[k].tolist(),
        }
        for k in range(2)
    ]
    errors = []
    for dt in (2e-3, 1e-3):
        space, scale = ended(balls, {"constant": 10.0}, fixed_dt=dt)
        errors.append(np.abs(space.state.position[1] - space.state.position[0] - exact).max())
        assert abs(space.ledger.friction) < 1e-6 * scale
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.1)
    assert errors[1] < 1e-4
