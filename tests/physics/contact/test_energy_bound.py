"""Impulses that are still too large after the iterations are scaled back, and booked once."""

from __future__ import annotations

import numpy as np
import pytest

from carom.physics.space import Space
from carom.scene.load import Scene

EPS = float(np.finfo(float).eps)


def falling(threads: int) -> Space:
    """A lattice of 125 spheres, 2.4 radii apart, that falls into a box; four sweeps do not converge."""
    rng = np.random.default_rng(0)
    sites = np.stack(np.meshgrid(*[np.arange(5.0)] * 3, indexing="ij"), axis=-1).reshape(-1, 3) * 0.24
    sites += rng.uniform(-0.019, 0.019, sites.shape) - [0.48, 0.48, 1.0]
    return Space(
        Scene.from_dict(
            {
                "body": [{"position": site.tolist(), "mass": 1.0, "radius": 0.1} for site in sites],
                "gravity": {"constant": 0.0, "uniform": [0.0, 0.0, -9.81]},
                "contact": {"timing": "end-of-step", "sweeps": "quick", "restitution": 0.0},
                "domain": {"boundary": "walls", "size": [1.2, 1.2, 2.4]},
                "time": {"duration": 10.0, "fixed_dt": 1 / 60},
            }
        ),
        threads,
    )


@pytest.mark.parametrize("threads", [1, 2])
def test_the_ledger_holds_impulses_as_they_were_scaled_back(threads: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("carom.physics.contact.solver.contact_solver.SHARED_FROM", 0)
    space = falling(threads)
    assert space._contact is not None
    settings, steps, scaled = space._contact.solver._settings, 60, 0
    for step in range(steps):
        space.compute_dynamics(step + 1)
        scaled += int(settings["scaled_back"][0])
    energy = space.energy()
    assert scaled > 0
    # The integrator is exact in a uniform field: what is left is rounding, of some 400 contacts twice a step.
    assert abs(energy.integration_error) <= EPS * 2 * 400 * steps * energy.scale
    assert energy.ledger.restitution > 0.0 and energy.ledger.friction >= 0.0
