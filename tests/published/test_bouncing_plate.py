"""A ball on an oscillating plate: its period doubles at the threshold of the exact map.

Bounces of period 1 rise with g T/2 and meet the plate at the phase φ, where Γ cos φ = π (1 - e)/(1 + e) and
Γ = A ω²/g. The map of time and velocity from bounce to bounce, linearised there, has the determinant e² and the trace
1 + e² - (1 + e)² Γ sin φ (Tufillaro, Abbott & Reilly 1992, An Experimental Approach to Nonlinear Dynamics and Chaos;
Luck & Mehta 1993, Phys. Rev. E 48, 3988). One of its eigenvalues is -1, and the period doubles, where
Γ sin φ = 2 (1 + e²)/(1 + e)².
"""

from __future__ import annotations

import math

import numpy as np
import pytest

from carom import Scene, Space
from carom.arrays import FloatArray
from carom.physics.schedule import every

E, T, G = 0.5, 0.1, 9.81  # restitution, s and m/s²
OMEGA = 2.0 * math.pi / T
RADIUS = 5.0  # m; a smaller ball takes shorter steps, and bounces alike
ALONG, ACROSS = math.pi * (1.0 - E) / (1.0 + E), 2.0 * (1.0 + E * E) / (1.0 + E) ** 2
THRESHOLD = math.hypot(ALONG, ACROSS)  # 1.527


def rises(strength: float, bounces: int) -> FloatArray:
    """Return the durations of flights in T at a Γ, from bounces of period 1 that start 1 % too fast."""
    amplitude = strength * G / OMEGA**2
    phase = math.acos(ALONG / strength)
    scene = Scene.from_dict(
        {
            "contact": {"restitution": E, "static_friction": 0.0, "kinetic_friction": 0.0},
            "gravity": {"constant": 0.0, "uniform": [0.0, 0.0, -G]},
            "plane": [{"motion": {"amplitude": [0, 0, amplitude], "frequency": 1.0 / T, "phase": phase}}],
            "body": [
                {
                    "radius": RADIUS,
                    "position": [0, 0, RADIUS + amplitude * math.sin(phase) + 1e-9],
                    "velocity": [0, 0, 1.01 * 0.5 * G * T],
                }
            ],
            "time": {"duration": bounces * T, "max_dt": 0.02 * T},
        }
    )
    frames = list(Space(scene).run(schedule=every(0.1 * T)))
    time = np.array([frame.time for frame in frames])
    launched = np.array([frame.velocity[0, 2] for frame in frames]) + G * time  # constant in a flight
    change = np.diff(launched)
    return np.asarray(change[np.abs(change) > 0.1 * G * T] / (G * T))


@pytest.mark.slow  # kernels for walls are compiled for a minute
def test_bounces_keep_their_period_below_the_threshold() -> None:
    flights = rises(0.97 * THRESHOLD, 80)
    # 3 % below, the eigenvalue is about -0.85
    assert flights[-6:] == pytest.approx(np.ones(6), abs=1e-4)


@pytest.mark.slow  # kernels for walls are compiled for a minute
def test_the_period_of_bounces_doubles_above_the_threshold() -> None:
    flights = rises(1.03 * THRESHOLD, 120)[-8:]
    assert flights[::2] == pytest.approx(np.full(4, flights[0]), abs=1e-3)
    assert flights[1::2] == pytest.approx(np.full(4, flights[1]), abs=1e-3)
    assert abs(flights[0] - flights[1]) == pytest.approx(0.069, abs=0.001)  # of the map, iterated
    assert flights.mean() == pytest.approx(1.0, abs=1e-3)
