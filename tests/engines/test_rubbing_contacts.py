"""Friction beyond μ is named from the states of bodies that slide, though no impact shows it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import carom

G, RADIUS, MASS, DT = 9.81, 0.1, 0.5, 1.0 / 240.0
COEFFICIENTS = np.array([0.3, 0.3, 0.3, 0.05])  # the last ball is made of ice


class Bowling:
    """Balls slide over a floor until they roll; friction may be ``factor`` times too large on ball 1 in one step."""

    def __init__(self, wrong_step: int = -1, factor: float = 1.0, frame: int = 1) -> None:
        n = len(COEFFICIENTS)
        self.model = carom.record.Model(
            engine="bowling 1.0",
            mass=np.full(n, MASS),
            radius=np.full(n, RADIUS),
            gravity=(0.0, 0.0, -G),
            planes=[carom.record.Plane((0.0, 0.0, 1.0), 0.0, "floor")],
        )
        self.wrong_step, self.factor, self.substeps = wrong_step, factor, frame
        self.step = 0
        self.x = np.array([[0.0, k, RADIUS] for k in range(n)])
        self.v = np.array([[8.0 + 0.5 * k, 0.1 * k, 0.0] for k in range(n)])
        self.w = np.zeros((n, 3))

    def advance(self) -> None:
        """Make a step: J_t = μ m g dt against the slip, or what ends the slip."""
        slip = self.v + np.cross(self.w, [0.0, 0.0, -RADIUS])
        speed = np.linalg.norm(slip, axis=1)
        largest = COEFFICIENTS * G * DT
        if self.step + 1 == self.wrong_step:
            largest = largest * np.where(np.arange(len(slip)) == 1, self.factor, 1.0)
        push = np.minimum(largest, speed / 3.5) / np.maximum(speed, 1e-300)
        change = -push[:, None] * slip  # m/s
        self.v += change
        self.w += np.cross([0.0, 0.0, -RADIUS], change) / (0.4 * RADIUS**2)
        self.x += self.v * DT
        self.step += 1

    def state(self) -> carom.record.State:
        return carom.record.State(self.step * DT, self.x.copy(), self.v.copy(), angular_velocity=self.w.copy())


def recorded(run: Bowling, path: Path) -> list[carom.record.Fault]:
    with carom.record.Recorder(run, path) as recorder:
        for _ in range(120):
            for _ in range(run.substeps):
                run.advance()
            recorder.frame()
    return recorder.faults


@pytest.mark.parametrize("factor", [0.0, 0.5, 1.5])
def test_a_slide_with_another_friction_in_one_step_is_named(factor: float, tmp_path: Path) -> None:
    (fault,) = recorded(Bowling(60, factor), tmp_path / "run.rrd")
    assert (fault.law, fault.step, fault.bodies) == ("friction", 60, (1, 4))


@pytest.mark.parametrize("frame", [1, 3])
def test_balls_of_two_materials_that_slide_until_they_roll_break_no_law(frame: int, tmp_path: Path) -> None:
    assert recorded(Bowling(frame=frame), tmp_path / "run.rrd") == []
