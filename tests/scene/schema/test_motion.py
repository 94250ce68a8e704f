"""Prescribed motions of walls."""

from __future__ import annotations

import numpy as np
import pytest

from carom.scene.schema.motion import WallMotion


def test_the_displacement_of_an_oscillating_wall_is_its_amplitude_times_a_sine_beside_its_drift() -> None:
    motion = WallMotion(velocity=(1.0, 0.0, 0.0), amplitude=(0.0, 0.5, -0.25), frequency=2.0, phase=0.3)
    t = np.array([0.0, 0.1, 0.7])
    sine = np.sin(2.0 * np.pi * 2.0 * t + 0.3)
    expected = np.stack([t, 0.5 * sine, -0.25 * sine], axis=1)
    assert motion.displacement(t) == pytest.approx(expected, abs=1e-14)
    along = motion.displacement(t, np.array([0.0, 1.0, 0.0]))  # of a drawn plane: velocities along its normal only
    assert along == pytest.approx(expected - np.stack([t, 0.0 * t, 0.0 * t], axis=1), abs=1e-14)


def test_a_wall_that_changes_its_velocity_moves_by_the_integral_of_its_velocities() -> None:
    motion = WallMotion(times=(1.0, 3.0), velocities=((0.0, 0.0, 2.0), (0.0, 0.0, -1.0)))
    assert motion.displacement(np.array([0.5, 2.0, 5.0]))[:, 2] == pytest.approx([0.0, 2.0, 4.0 - 2.0])
