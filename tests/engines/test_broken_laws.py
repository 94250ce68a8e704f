"""Broken laws of another engine are ranked, checked by `inspect --check`, and shown by a report."""

from __future__ import annotations

import dataclasses
import zipfile
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import carom
from carom.cli.main import app
from carom.event import Event
from carom.recording.edit import bundle
from carom.recording.read.recording import Recording
from carom.sharing.report import report, worst_moment

STEPS, DT = 180, 0.01  # s; a report's clip has 120 frames
JUMP = 170  # step in which a free body gains speed from nothing: energy and momentum change by far more than 0.1 %


class Faulty:
    """A body in free flight, and two at rest that overlap by 6 %, 1.2 times a tolerance; or all without a fault."""

    model = carom.record.Model(engine="mine 1", mass=np.ones(3), radius=np.full(3, 0.1), names=["comet", "a", "b"])

    def __init__(self, faulty: bool) -> None:
        self.faulty, self.step = faulty, 0

    def state(self) -> carom.record.State:
        x = np.array([[0.0, 0.0, 5.0], [0.0, 0.0, 0.0], [0.194 if self.faulty else 0.3, 0.0, 0.0]])
        v = np.zeros((3, 3))
        late = max(self.step - JUMP, 0) if self.faulty else 0
        v[0, 0] = 2.0 if late else 1.0
        x[0, 0] = (self.step + late) * DT
        return carom.record.State(self.step * DT, x, v, angular_velocity=np.zeros((3, 3)))


def recorded(path: Path, faulty: bool) -> Path:
    source = Faulty(faulty)
    with carom.record.Recorder(source, path, tolerances=carom.record.Tolerances(overlap=0.05)) as recorder:
        for source.step in range(1, STEPS):
            recorder.frame()
    return path


@pytest.fixture(scope="module")
def broken(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return recorded(tmp_path_factory.mktemp("laws") / "broken.rrd", True)


def test_each_law_has_its_violation_over_tolerance_and_an_overlap_comes_last(broken: Path) -> None:
    laws = Recording.open(broken).summary()["laws"]
    assert list(laws)[-1] == "overlap" and laws["overlap"]["step"] < JUMP < laws["energy"]["step"]
    excess = [law["excess"] for law in laws.values()]
    assert excess == sorted(excess, reverse=True)
    assert laws["overlap"]["bodies"] == [1, 2] and laws["energy"]["bodies"] == [0]


def test_inspect_check_fails_and_names_law_body_and_step(broken: Path, tmp_path: Path) -> None:
    bad = CliRunner().invoke(app, ["inspect", str(broken), "--check"])
    assert bad.exit_code == 1
    assert f"the law energy is broken, first at step {JUMP + 1}" in bad.stderr and 'body 0 "comet"' in bad.stderr
    good = CliRunner().invoke(app, ["inspect", str(recorded(tmp_path / "good.rrd", False)), "--check"])
    assert good.exit_code == 0 and good.stderr == ""


@pytest.mark.slow
def test_a_report_is_of_the_worst_law_and_holds_the_first_frame_of_each(broken: Path, tmp_path: Path) -> None:
    recording = Recording.open(broken)
    made = report(recording, tmp_path / "report.zip")
    worst = next(iter(recording.summary()["laws"].values()))
    assert made.time == worst["time"] and worst["text"].startswith(made.why)
    with zipfile.ZipFile(tmp_path / "report.zip") as members:
        for name in (bundle.CLIP, "law-overlap.rrd"):
            members.extract(name, tmp_path)
    shown = [
        Recording.open(tmp_path / name).fingerprints()["step"].to_numpy() for name in (bundle.CLIP, "law-overlap.rrd")
    ]
    overlap = recording.summary()["laws"]["overlap"]["step"]
    assert worst["step"] in shown[0] and overlap not in shown[0] and overlap in shown[1]


class Odd(Faulty):
    """A source whose time stops, or whose constants change, in one step."""

    def __init__(self, odd: str) -> None:
        super().__init__(False)
        radius = np.array([0.1, 0.1, 0.0 if odd == "radius 0" else 0.1])
        self.odd, self.model = odd, dataclasses.replace(Faulty.model, mass=np.ones(3), radius=radius)

    def state(self) -> carom.record.State:
        state = super().state()
        if self.step == 7 and self.odd == "time":
            state.time = (self.step - 1) * DT
        if self.step == 7 and self.odd in ("mass", "radius"):
            getattr(self.model, self.odd)[1] = 0.05
        return state


@pytest.mark.parametrize(
    ("odd", "step", "said"),
    [
        ("none", 0, ""),
        ("time", 7, "the time did not advance, it is still 0.06 s"),
        ("mass", 7, 'the mass of body 1 "a" changed from 1 kg to 0.05 kg'),
        ("radius", 7, 'the radius of body 1 "a" changed from 0.1 m to 0.05 m'),
        ("radius 0", 0, 'body 2 "b" has the radius 0'),
    ],
)
def test_a_bad_source_is_named_at_its_frame(odd: str, step: int, said: str, tmp_path: Path) -> None:
    source = Odd(odd)
    with carom.record.Recorder(source, tmp_path / "odd.rrd") as recorder:
        for source.step in range(1, 12):
            recorder.frame()
    assert len(recorder.problems) == bool(said) and all(said in problem for problem in recorder.problems)
    noted = [event for event in Recording.open(tmp_path / "odd.rrd").warnings() if event.kind == "not-recorded"]
    assert [event.step for event in noted] == [step] * bool(said)


@pytest.mark.parametrize(
    ("steps", "order"),
    [
        ({"energy": 137, "friction": 64}, ["friction", "energy"]),  # the friction added the energy
        ({"energy": 43, "friction": 64}, ["energy", "friction"]),
        ({"energy": 137, "momentum": 20}, ["momentum", "energy"]),  # an impulse on one body only
        ({"energy": 64, "pull": 64}, ["energy", "pull"]),  # of one step, the larger violation
        ({"overlap": 20, "pull": 64}, ["pull", "overlap"]),  # the accuracy of the engine
        ({"not-finite": 137, "energy": 64}, ["energy", "not-finite"]),  # the end of an explosion
    ],
)
def test_the_law_that_was_broken_first_comes_first_since_later_ones_may_be_its_consequences(
    steps: dict[str, int], order: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    recording = Recording.open(recorded(tmp_path / "good.rrd", False))
    assert isinstance(recording.closing, dict)
    for name, step in steps.items():
        excess = 300.0 if name in ("energy", "overlap") else 2.0
        found = {"step": step, "time": DT * step, "frames": 1, "text": name, "excess": excess, "bodies": "1,2"}
        recording.closing.update({f"laws.{name}.{key}": value for key, value in found.items()})
    assert list(recording.summary()["laws"]) == order
    events = [Event(step, DT * step, "WARN", name, f"law-{name}") for name, step in steps.items()]
    monkeypatch.setattr(Recording, "warnings", lambda _: events)
    assert worst_moment(recording) == (DT * steps[order[0]], order[0]), "a report begins with the same law"
