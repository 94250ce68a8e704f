"""Measured and published values of the contact laws beside Coulomb's.

Foerster, Louge, Chang & Allia, Phys. Fluids 6, 1108 (1994): binary impacts of spheres of soda lime glass have
e = 0.97, μ = 0.092, β₀ = 0.44, of cellulose acetate e = 0.87, μ = 0.25, β₀ = 0.43. With Ψ = v_t/v_n of the contact
point before the impact, their data follow Ψ' = -β₀ Ψ where the contact sticks, and Ψ' = Ψ - (7/2)(1 + e) μ where it
slides, from Ψ = (7/2)(1 + e) μ/(1 + β₀) on.

Brilliantov & Pöschel, Phys. Rev. E 61, 5573 (2000): a granular gas of viscoelastic spheres cools as t^{-5/3}, one with
a constant coefficient of restitution as t⁻² (Haff 1983).
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from carom import Scene
from carom.arrays import FloatArray
from carom.physics.space import Space
from periodic_gas import gas, temperature
from small_scenes import scene_of


@pytest.mark.slow  # kernels for a law are compiled for 8 s
@pytest.mark.parametrize("psi", [0.1, 0.3, 0.43, 0.45, 1.0, 1.1, 1.2, 3.0])
@pytest.mark.parametrize(("e", "mu", "beta"), [(0.97, 0.092, 0.44), (0.87, 0.25, 0.43)], ids=["glass", "acetate"])
def test_spheres_reverse_the_slip_as_measured_by_foerster(e: float, mu: float, beta: float, psi: float) -> None:
    # One step of 1/16 s closes the gap without round-off, as in test_oblique_impact.
    dt = 1 / 16
    left = {"position": [-1.0 - dt / 2, 0.0, 0.0], "velocity": [0.5, 0.0, 0.0], "mass": 1.0}
    right = {"position": [1.0 + dt / 2, -psi * dt, 0.0], "velocity": [-0.5, psi, 0.0], "mass": 1.0}
    contact = {"restitution": e, "static_friction": mu, "kinetic_friction": mu, "timing": "end-of-step"}
    law = {"law": "walton", "walton": {"tangential_restitution": beta}}
    space = Space(
        scene_of([left, right], gravity={"constant": 0.0}, contact=contact | law, time={"fixed_dt": dt, "duration": dt})
    )
    space.compute_dynamics(1)
    closing = space.state.velocity[1] - space.state.velocity[0]
    slip = closing - np.cross(space.state.angular_velocity.sum(axis=0), [1.0, 0.0, 0.0])
    expected = -beta * psi if psi <= 3.5 * (1 + e) * mu / (1 + beta) else psi - 3.5 * (1 + e) * mu
    assert float(slip[1]) == pytest.approx(expected, abs=1e-14 * (1 + psi))  # some ten operations


@pytest.mark.nightly
@pytest.mark.slow
@pytest.mark.parametrize("speed", [5e-5, 1e-3, 1e-2])
def test_ice_of_saturns_rings_rebounds_as_measured_by_bridges(speed: float) -> None:
    # Bridges, Hatzes & Lin, Nature 309, 333 (1984): e = 0.32 v^-0.234 with v in cm/s, and 1 below 0.0077 cm/s. The
    # impact leaves rounding, and the power law has e = 0.3201 at 1 cm/s.
    law = {"law": "power_law", "power_law": {"speed": 7.7e-5, "exponent": 0.234}, "timing": "end-of-step"}
    balls = [
        {"position": [sign * 1.5, 0.0, 0.0], "velocity": [-sign * speed / 2, 0.0, 0.0], "mass": 1.0} for sign in (-1, 1)
    ]
    space = Space(scene_of(balls, gravity={"constant": 0.0}, contact=law, time={"duration": 3.0 / speed}))
    *_, frame = space.run()
    measured = (frame.velocity[1, 0] - frame.velocity[0, 0]) / speed
    assert measured == pytest.approx(min(1.0, 0.32 * (100.0 * speed) ** -0.234), rel=1e-3)


@pytest.mark.slow
def test_a_ball_rolls_to_rest_in_the_distance_that_its_rolling_friction_gives() -> None:
    # A solid ball decelerates by 5/7 μ_r g, over v²/(2 · 5/7 μ_r g). The force of a step acts at its end: the distance
    # is right to v dt.
    v, mu, g, dt = 1.0, 0.05, 9.81, 0.001
    ball = {
        "position": [0.0, 0.0, 0.1],
        "radius": 0.1,
        "velocity": [v, 0.0, 0.0],
        "angular_velocity": [0.0, v / 0.1, 0.0],
    }
    law = {"law": "rolling_resistance", "rolling_resistance": {"rolling_friction": mu}}
    distance = v**2 / (2 * 5 / 7 * mu * g)
    space = Space(
        scene_of(
            [ball],
            plane=[{}],
            gravity={"constant": 0.0, "uniform": [0, 0, -g]},
            contact={"static_friction": 0.5, "kinetic_friction": 0.5, "timing": "end-of-step", **law},
            time={"duration": 1.2 * v / (5 / 7 * mu * g), "fixed_dt": dt},
        )
    )
    *_, frame = space.run()
    assert frame.position[0, 0] == pytest.approx(distance, abs=2 * v * dt)
    assert abs(frame.velocity[0, 0]) < 1e-12


@pytest.mark.nightly
@pytest.mark.slow
def test_a_gas_of_viscoelastic_spheres_cools_with_the_exponent_five_thirds() -> None:
    # T^{-1/p} is a straight line in time. Seeds scatter by 0.05 about 1.68; a constant coefficient gives 2.00 ± 0.01.
    # 0.15: three times the scatter.
    law = {"law": "viscoelastic", "viscoelastic": {"restitution": 0.9, "speed": 1.5}}
    space = gas(5, 0.05, 0, contact={"static_friction": 0.0, "timing": "end-of-step", **law}, time={"cfl": 0.03})
    times, temperatures = [0.0], [1.0]
    while temperatures[-1] > 0.01:
        space.compute_dynamics(50)
        times.append(space.time)
        temperatures.append(temperature(space))
    time, late = np.array(times), np.array(temperatures) < 0.5

    def bend(power: float) -> float:
        line = np.array(temperatures)[late] ** (-1 / power)
        return float(np.std(np.polyval(np.polyfit(time[late], line, 1), time[late]) / line))

    powers = np.linspace(1.2, 2.6, 141)
    assert powers[np.argmin([bend(power) for power in powers])] == pytest.approx(5 / 3, abs=0.15)


def rebound_of_hertzian_spheres(mass: float, radius: float, dissipation: float, speed: float) -> float:
    """Return e from the equation of motion m ξ'' = -√r (ξ^{3/2} + A √ξ ξ'), in units of the elastic constant."""
    stiffness = np.sqrt(radius) / mass

    def force(time: float, state: FloatArray) -> list[float]:
        depth, rate = state
        root = np.sqrt(max(0.0, depth))
        return [rate, -stiffness * (root**3 + dissipation * root * rate)]

    def ends(time: float, state: FloatArray) -> float:  # where the force is 0; it never pulls
        return float(state[0] + dissipation * state[1]) if time > 0.0 else 1.0

    ends.terminal = True  # type: ignore[attr-defined]
    path = solve_ivp(force, (0.0, 100.0), [1e-12, speed], events=ends, rtol=1e-9, atol=1e-13)
    return float(-path.y[1, -1] / speed)


@pytest.mark.nightly
@pytest.mark.slow  # kernels for a law are compiled for 8 s
@pytest.mark.parametrize("scale", [0.2, 1.0, 5.0])
@pytest.mark.parametrize("partner", ["equal", "ten times as large", "a plane"])
def test_viscoelastic_spheres_of_other_sizes_rebound_as_their_equation_of_motion_says(
    scale: float, partner: str
) -> None:
    # Brilliantov, Spahn, Hertzsch & Pöschel, Phys. Rev. E 53, 5382 (1996); one constant A, fitted to the measured pair
    measured, density, speed, e = 0.01, 2000.0, 1.0, 0.8

    def reduced(one: float, other: float) -> tuple[float, float]:
        mass = density * 4.0 / 3.0 * np.pi
        return mass / (one**-3 + other**-3), 1.0 / (1.0 / one + 1.0 / other)

    dissipation = brentq(
        lambda A: rebound_of_hertzian_spheres(*reduced(measured, measured), A, speed) - e, 1e-6, 1.0, rtol=1e-9
    )
    radius = scale * measured
    other = {"equal": radius, "ten times as large": 10.0 * radius, "a plane": np.inf}[partner]
    expected = rebound_of_hertzian_spheres(*reduced(radius, other), dissipation, speed)
    section = {"restitution": e, "speed": speed, "radius": measured, "density": density}
    start = 3.0 * radius
    document: dict[str, Any] = {"gravity": {"constant": 0.0}, "time": {"duration": 2.0 * start / speed}}
    document["contact"] = {"law": "viscoelastic", "viscoelastic": section}
    document["body"] = [{"radius": radius, "density": density, "position": [0, 0, start], "velocity": [0, 0, -speed]}]
    if partner == "a plane":
        document["plane"] = [{}]
    else:
        document["body"] += [{"radius": other, "density": density, "position": [0, 0, -other]}]
    *_, frame = Space(Scene.from_dict(document)).run()
    velocity = frame.velocity[:, 2]
    after = velocity[0] if partner == "a plane" else velocity[0] - velocity[1]
    # the Padé approximant is within 0.01 of the equation's solution
    assert after / speed == pytest.approx(expected, abs=0.01)
    if partner == "equal" and scale != 1.0:
        assert abs(expected - e) > 0.1  # sizes matter here
