"""What commands say of one recording of another engine does not contradict what others say of it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import carom
from carom.recording.read.recording import Recording
from carom_command import carom as command

DT, SPEED, OVERLAP = 0.01, 1.0, 0.01  # s, m/s and m, of balls that close by 0.02 m in a step
MET, RESOLVED = 3, 4  # steps in which the balls overlap, and in which the engine reverses them


class Late:
    """Two balls that collide head on; the engine finds their contact one step after they overlap."""

    model = carom.record.Model(engine="late 1", mass=np.ones(2), radius=np.full(2, 0.1))

    def __init__(self, friction: float = 0.0) -> None:
        self.friction, self.step = friction, 0  # m/s, added along y to one ball, and taken from the other

    def state(self) -> carom.record.State:
        resolved = self.step >= RESOLVED
        moved = (2 * MET - self.step if resolved else self.step) * SPEED * DT
        x, v = np.zeros((2, 3)), np.zeros((2, 3))
        x[:, 0] = np.array([-1.0, 1.0]) * (0.125 - moved)
        v[:, 0] = np.array([1.0, -1.0]) * (-SPEED if resolved else SPEED)
        v[:, 1] = np.array([-1.0, 1.0]) * (self.friction if resolved else 0.0)
        x[:, 1] = v[:, 1] * DT * max(self.step - RESOLVED, 0)
        contacts = np.zeros(int(self.step == RESOLVED), carom.record.CONTACT)
        contacts["j"], contacts["normal"], contacts["force"] = 1, (1.0, 0.0, 0.0), 2.0 * SPEED / DT
        contacts["friction"][:, 1] = self.friction / DT
        return carom.record.State(self.step * DT, x, v, contacts=contacts)


def recorded(path: Path, source: Late) -> Path:
    with carom.record.Recorder(source, path, tolerances=carom.record.Tolerances(overlap=0.05)) as recorder:
        for source.step in range(1, 9):
            recorder.frame()
    return path


@pytest.fixture(scope="module")
def late(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return recorded(tmp_path_factory.mktemp("late") / "late.rrd", Late())


def test_the_deepest_overlap_is_that_of_the_broken_law_although_the_engine_reports_no_contact(late: Path) -> None:
    summary = Recording.open(late).summary()
    assert summary["moments"]["overlap"]["step"] == summary["laws"]["overlap"]["step"] == MET
    assert summary["moments"]["overlap"]["value"] == pytest.approx(OVERLAP / 0.1)
    assert "overlap by 10.0%" in summary["laws"]["overlap"]["text"]


def test_the_hardest_impact_is_in_the_step_of_its_force_and_has_a_cause(late: Path) -> None:
    summary = Recording.open(late).summary()
    assert summary["moments"]["impact"]["step"] == RESOLVED
    assert summary["moments"]["impact"]["value"] == pytest.approx(0.5 * 0.5 * (2.0 * SPEED) ** 2)
    assert summary["contacts"]["impacts"] == 1
    said = command("why", str(late), "--event", "impact", cwd=late.parent)
    assert said.returncode == 0 and "Why do body 0 and body 1 touch" in said.stdout


def test_a_difference_in_friction_is_told_where_the_normal_forces_are_the_same(tmp_path: Path) -> None:
    one, other = (recorded(tmp_path / f"{name}.rrd", Late(each)) for name, each in (("a", 0.125), ("b", -0.125)))
    text = " ".join(command("diff", str(one), str(other), cwd=tmp_path).stdout.split())
    assert "normal force 200 N in both; friction 12.5 N in both, 180° apart" in text
    assert "below 0e+00" not in text and "no distance yet" in text
