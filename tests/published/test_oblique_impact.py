"""Oblique impact with Coulomb friction: slip after the impact over the whole range of angles.

For two equal full spheres with Ψ = v_t/v_n of the contact point before the impact (Maw, Barber & Fawcett, Wear 38, 101,
1976; the rigid limit): a contact that sticks ends without slip, one that slides keeps Ψ' = Ψ - (7/2) μ (1 + e), and
the switch is at Ψ* = (7/2) μ (1 + e). Measured spheres reverse the slip (β₀ ≈ 0.44, Foerster et al. 1994), which
stick-or-slide friction cannot.
"""

from __future__ import annotations

import numpy as np
import pytest

from carom.physics.reference_api import BodyProxy, CollisionContext
from carom.physics.space import Space
from small_scenes import random_bodies, scene_of


def slip_after(psi: float, restitution: float, static_friction: float, kinetic_friction: float) -> tuple[float, float]:
    """Let two equal full spheres meet in a run, Ψ = v_t/v_n; return Ψ' and the ratio of the normal velocities.

    One step of 1/16 s closes the gap without round-off: the centres are then on the x axis, at a distance of 2. The
    impact is resolved there, at the end of the step: its own moment is a root, whose rounding a graze makes Ψ² larger.
    """
    dt = 1 / 16
    left = {"position": [-1.0 - dt / 2, 0.0, 0.0], "velocity": [0.5, 0.0, 0.0], "mass": 1.0}
    right = {"position": [1.0 + dt / 2, -psi * dt, 0.0], "velocity": [-0.5, psi, 0.0], "mass": 1.0}
    friction = {"static_friction": static_friction, "kinetic_friction": kinetic_friction}
    scene = scene_of(
        [left, right],
        gravity={"constant": 0.0},
        contact={"restitution": restitution, "timing": "end-of-step", **friction},
        time={"fixed_dt": dt, "duration": dt},
    )
    space = Space(scene)
    space.compute_dynamics(1)
    assert space.extremes.impacts == 1
    closing = space.state.velocity[1] - space.state.velocity[0]
    arms = space.state.angular_velocity.sum(axis=0)  # m/s, radii of 1 m
    slip = closing - np.cross(arms, [1.0, 0.0, 0.0])
    return float(slip[1]), float(slip[0])


@pytest.mark.parametrize("psi", [0.0, 0.2, 0.5, 1.0, 1.5, 1.8, 1.9, 2.5, 5.0, 20.0])
def test_slip_after_an_oblique_impact_is_zero_or_what_kinetic_friction_leaves(psi: float) -> None:
    mu, e = 0.3, 0.8
    switch = 3.5 * mu * (1 + e)
    bodies = random_bodies(2, 0)
    bodies.mass[:], bodies.radius[:], bodies.inertia[:] = 1.0, 1.0, 0.4
    bodies.ends.inverse_mass[:], bodies.ends.inverse_inertia[:] = 1.0, 2.5
    bodies.angular_velocity[:] = 0.0
    bodies.position[:] = [[0, 0, 0], [2, 0, 0]]
    bodies.velocity[:] = [[1.0, 0, 0], [0, psi, 0]]
    first, second = BodyProxy(bodies, 0), BodyProxy(bodies, 1)
    context = CollisionContext.from_bodies(first, second)
    assert context is not None
    context.resolve(e, mu, mu)
    after = CollisionContext.from_bodies(first, second)
    assert after is not None
    expected = 0.0 if psi <= switch else psi - switch
    assert np.allclose(after.v_rel[1:], [expected, 0.0], rtol=0, atol=1e-13)
    assert after.v_rel[0] == pytest.approx(e, abs=1e-14)


@pytest.mark.parametrize("angle", [0, 5, 15, 30, 45, 55, 60, 65, 70, 75, 80, 85, 89, 89.9])
@pytest.mark.parametrize(("restitution", "friction"), [(1.0, 0.092), (0.97, 0.092), (0.83, 0.125), (0.0, 0.5)])
def test_slip_after_an_impact_of_a_run_from_head_on_to_grazing(
    angle: float, restitution: float, friction: float
) -> None:
    # e and μ of Foerster et al.'s soda lime glass and cellulose acetate (1994), and of two ends. Round-off: some ten
    # operations on numbers of the size of Ψ.
    psi = float(np.tan(np.radians(angle)))
    switch = 3.5 * friction * (1 + restitution)
    after, rebound = slip_after(psi, restitution, friction, friction)
    assert after == pytest.approx(max(0.0, psi - switch), abs=1e-14 * (1 + psi))
    assert rebound == pytest.approx(restitution, abs=1e-15)


@pytest.mark.parametrize("friction", [0.05, 0.3, 1.0])
@pytest.mark.parametrize("restitution", [0.0, 0.5, 1.0])
def test_a_contact_sticks_up_to_the_angle_of_static_friction_and_slides_with_the_kinetic_one_beyond(
    friction: float, restitution: float
) -> None:
    # The switch is at Ψ* = (7/2) μ_s (1 + e), tried 1e-9 of it to either side; sliding takes (7/2) μ_k (1 + e), here
    # half of Ψ*. Round-off, as above.
    switch = 3.5 * friction * (1 + restitution)
    stuck, _ = slip_after(switch * (1 - 1e-9), restitution, friction, friction / 2)
    beyond = switch * (1 + 1e-9)
    slid, _ = slip_after(beyond, restitution, friction, friction / 2)
    assert stuck == pytest.approx(0.0, abs=1e-14 * (1 + switch))
    assert slid == pytest.approx(beyond - switch / 2, abs=1e-14 * (1 + beyond))
