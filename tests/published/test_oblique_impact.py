"""Oblique impact with Coulomb friction: slip after the impact over the whole range of angles.

For two equal full spheres with Ψ = v_t/v_n of the contact point before the impact (Maw, Barber & Fawcett, Wear 38, 101,
1976; the rigid limit): a contact that sticks ends without slip, one that slides keeps Ψ' = Ψ - (7/2) μ (1 + e), and
the switch is at Ψ* = (7/2) μ (1 + e). Measured spheres reverse the slip (β₀ ≈ 0.44, Foerster et al. 1994), which
stick-or-slide friction cannot.
"""

from __future__ import annotations

import numpy as np
import pytest

from carom.physics.bodies import BodyProxy
from carom.physics.contact.impulse import CollisionContext
from examples import random_bodies


@pytest.mark.parametrize("psi", [0.0, 0.2, 0.5, 1.0, 1.5, 1.8, 1.9, 2.5, 5.0, 20.0])
def test_slip_after_the_impact(psi: float) -> None:
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
