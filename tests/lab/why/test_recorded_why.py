"""`carom why` of other engines: the answer follows from recorded states and contact forces."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import carom
from carom.errors import ExperimentError, RecordingError
from carom.lab.why.history import question_of
from carom.lab.why.why import why
from carom.recording.read.recording import Recording
from carom_command import carom as command

DT = 0.001  # s
FLOAT32 = 1e-6  # relative; recorded impulses are in float32
STIFF = 4e4  # N/m, so that a contact of balls of 1 kg lasts for π √(½ / k) = 11 steps


class Springs:
    """Balls of 1 kg whose contacts are undamped springs, advanced by symplectic Euler steps."""

    def __init__(
        self, x: Iterable[float], velocity: Iterable[float], gravity: float = 0.0, forces: bool = True
    ) -> None:
        self.x, self.v = (np.array([[each, 0.0, 0.0] for each in values]) for values in (x, velocity))
        n, self.time, self._g, self._forces = len(self.x), 0.0, np.array([0.0, 0.0, -gravity]), forces
        plane = [carom.record.Plane((0.0, 0.0, 1.0), -0.1, "floor")] if gravity else []
        self.fixed = np.zeros(n, bool)
        self.model = carom.record.Model(
            engine="springs",
            mass=np.ones(n),
            radius=np.full(n, 0.1),
            gravity=(0.0, 0.0, -gravity),
            planes=plane,
            fixed=self.fixed,
        )
        self.contacts = self._contacts()

    def _contacts(self) -> np.ndarray:
        n, found = len(self.x), []
        for i in range(n):
            for j in range(i + 1, n):
                away = self.x[j] - self.x[i]
                distance = float(np.linalg.norm(away))
                if distance < 0.2:
                    point, normal = self.x[i] + 0.5 * away, away / distance
                    found.append((i, j, point, normal, STIFF * (0.2 - distance), np.zeros(3)))
            if self._g.any() and self.x[i, 2] <= 0.0:  # heavily damped, so that balls rest at once
                force = max(0.0, -self._g[2] - self.v[i, 2] / DT)
                found.append((i, n, self.x[i] - [0.0, 0.0, 0.1], np.array([0.0, 0.0, -1.0]), force, np.zeros(3)))
        return np.array(found, carom.record.CONTACT)

    def step(self) -> None:
        self.contacts = self._contacts()
        force = np.tile(self._g, (len(self.x), 1))
        for contact in self.contacts:
            force[contact["i"]] -= contact["force"] * contact["normal"]
            if contact["j"] < len(self.x):
                force[contact["j"]] += contact["force"] * contact["normal"]
        self.v += DT * np.where(self.fixed[:, None], 0.0, force)
        self.x += DT * self.v
        self.time += DT

    def state(self) -> carom.record.State:
        return carom.record.State(self.time, self.x, self.v, contacts=self.contacts if self._forces else None)


def recorded(engine: Any, path: Path, steps: int = 500, **options: Any) -> Recording:
    with carom.record.Recorder(engine, path, **options) as recorder:
        for _ in range(steps):
            engine.step()
            recorder.frame()
    assert recorder.problems == []
    return Recording.open(path)


@pytest.mark.parametrize("options", [{}, {"exact": False}], ids=["exact", "one exact state in ten"])
def test_the_chain_of_soft_impacts_leads_back_to_the_ball_that_moved(options: dict[str, Any], tmp_path: Path) -> None:
    recording = recorded(Springs([0.0, 0.5, 1.0], [2.0, 0.0, 0.0]), tmp_path / "run.rrd", **options)
    answer = why(recording, question_of(recording, "2", None, None))
    assert [(link.by, link.body) for link in answer.chain] == [(1, 2), (0, 1)] and answer.first_cause == 0
    # two elastic impacts pass on 2 kg m/s each; a tenth of a bounce stays undivided between frames
    assert [link.impulse for link in answer.chain] == pytest.approx([2.0, 2.0], rel=0.01)
    assert [link.share for link in answer.chain] == pytest.approx([1.0, 1.0], abs=0.1)
    # 0.3 m and 0.6 m at 2 m/s, and the exact state after it
    assert [link.time for link in answer.chain] == pytest.approx([0.3, 0.15], abs=0.03)
    (cause,) = answer.accounts[0].causes
    assert cause.kind == "impact" and cause.lasts and cause.last - cause.first == pytest.approx(0.011, abs=0.003)
    assert cause.approach_speed == pytest.approx(2.0, rel=0.01) and cause.energy_lost is None
    assert cause.work == pytest.approx(2.0, rel=0.01)  # J, ½ m v²
    assert answer.engine == "springs" and answer.accounts[0].unexplained <= FLOAT32


def test_what_contacts_leave_of_a_velocity_is_the_field_and_a_floor_holds(tmp_path: Path) -> None:
    recording = recorded(Springs([0.0], [1.0], gravity=10.0), tmp_path / "run.rrd", steps=100)
    (account,) = why(recording, question_of(recording, "0", None, None)).accounts
    assert account.by_forces == pytest.approx([0.0, 0.0, -1.0], abs=FLOAT32)
    assert account.by_field == pytest.approx([0.0, 0.0, -1.0], rel=1e-12) and account.field_share == 0.0
    said = command("why", "run.rrd", "--body", "0", cwd=tmp_path).stdout
    assert "1 m/s (0, 0, -1)     0%  gravity gave it" in said and "  no contact explains" not in said
    assert account.by_contacts == pytest.approx([0.0, 0.0, 1.0], abs=FLOAT32)
    (cause,) = account.causes
    assert cause.kind == "contact" and cause.partner == 1 and abs(cause.work) <= FLOAT32
    assert account.start_share == pytest.approx(1.0, abs=FLOAT32)  # the floor and the weight cancel


class Blown(Springs):
    """A ball with wind from the side, which the engine does not report."""

    def step(self) -> None:
        self.v[:, 1] += DT * 5.0
        super().step()


def test_gravity_and_what_nothing_explains_have_their_own_lines_and_shares(tmp_path: Path) -> None:
    recording = recorded(Blown([0.0], [0.0], gravity=-20.0), tmp_path / "run.rrd", steps=100)  # upwards, off the floor
    (account,) = why(recording, question_of(recording, "0", None, None)).accounts
    assert account.by_forces - account.by_field == pytest.approx([0.0, 0.5, 0.0], abs=FLOAT32)
    # the shares are those of the squares: both forces are constant
    assert account.field_share == pytest.approx(400.0 / 425.0, rel=FLOAT32) and account.forces_share == pytest.approx(
        1.0
    )
    said = command("why", "run.rrd", "--body", "0", cwd=tmp_path).stdout
    assert " 94%  gravity gave it" in said and "  6%  no contact explains" in said
    told = json.loads(command("why", "run.rrd", "--body", "0", "--json", cwd=tmp_path).stdout)["accounts"][0]
    assert told["by_gravity"] == pytest.approx([0.0, 0.0, 2.0]) and told["gravity_share"] == account.field_share


def test_a_fixed_body_passes_nothing_on_and_has_no_velocity(tmp_path: Path) -> None:
    engine = Springs([0.0, 0.5, 0.7], [2.0, 0.0, 0.0])
    engine.fixed[1] = True
    recording = recorded(engine, tmp_path / "run.rrd")
    assert recording.fixed.tolist() == [False, True, False]
    answer = why(recording, question_of(recording, "0", None, None))
    assert answer.bodies.tolist() == [0] and answer.accounts[0].velocity[0] == pytest.approx(-2.0, rel=0.01)
    with pytest.raises(ExperimentError, match="a fixed body has no velocity"):
        why(recording, question_of(recording, "1", None, None))


class Visitors(Springs):
    """The third ball exists for some time only."""

    def state(self) -> carom.record.State:
        here = [0, 1, 2] if 0.2 <= self.time <= 0.4 else [0, 1]
        mass, radius = np.ones(len(here)), np.full(len(here), 0.1)
        contacts = self.contacts[np.maximum(self.contacts["i"], self.contacts["j"]) < len(here)]
        return carom.record.State(
            self.time, self.x[here], self.v[here], contacts=contacts, ids=np.array(here), mass=mass, radius=radius
        )


def test_an_account_begins_when_its_body_has_come(tmp_path: Path) -> None:
    visitors = Visitors([0.0, 0.5, 1.0], [2.0, 0.0, 0.0])
    visitors.model = carom.record.Model(engine="visitors", mass=[1.0, 1.0], radius=[0.1, 0.1])
    recording = recorded(visitors, tmp_path / "run.rrd")
    answer = why(recording, question_of(recording, "2", 0.39, None))
    assert answer.begin == pytest.approx(0.2, abs=2 * DT)
    assert [(link.by, link.body) for link in answer.chain] == [(1, 2)]
    with pytest.raises(ExperimentError, match=r"body 2 does not exist at t = 0\.1 s"):
        why(recording, question_of(recording, "2", 0.1, None))


def test_without_forces_of_contacts_the_causes_are_unknown(tmp_path: Path) -> None:
    recording = recorded(Springs([0.0, 0.5], [2.0, 0.0], forces=False), tmp_path / "run.rrd")
    with pytest.raises(RecordingError, match="forces of contacts are not in this recording of springs"):
        why(recording, question_of(recording, "0", None, None))


def test_the_command_says_what_its_numbers_are(tmp_path: Path) -> None:
    recorded(Springs([0.0, 0.5], [2.0, 0.0]), tmp_path / "run.rrd", every=5)
    said = command("why", "run.rrd", "--body", "1", "-o", "why.rrd", cwd=tmp_path).stdout
    assert "recorded from springs; a frame is up to 5 steps after the previous frame" in said
    assert "are estimates." in said
    assert "Impulses are the engine's contact forces times the time between frames" in said and "lost (J)" not in said
    told = json.loads(command("why", "run.rrd", "--body", "1", "--json", cwd=tmp_path).stdout)
    assert {cause["energy_lost"] for cause in told["accounts"][0]["causes"]} == {None}
    assert "no contact explains" in said and Recording.open(tmp_path / "why.rrd").is_overlay
