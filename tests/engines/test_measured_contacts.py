"""Coefficients, impulses and losses of another engine's contacts are measured from its states."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest

import carom
from carom.engines.measured_contacts import measured_contacts, measured_impacts
from carom.engines.scene_of_frame import _measured
from carom.physics.placement import place
from carom.recording.read.recording import Recording
from carom.scene.load import Scene
from carom_command import carom as command
from faulty_engines import DT, FRICTION, MASS, RADIUS, RESTITUTION, STEPS, G, Toy


def _of(spin: np.ndarray | None, bodies: list[int]) -> np.ndarray:
    assert spin is not None
    return spin[bodies]


@pytest.fixture(scope="module")
def toy(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    path, engine = tmp_path_factory.mktemp("toy") / "toy.rrd", Toy()
    with carom.record.Recorder(engine, path) as recorder:
        for _ in range(STEPS):
            engine.step()
            recorder.frame()
    return Recording.open(path)


def test_impacts_have_the_coefficients_of_the_engine_within_their_uncertainty(toy: Recording) -> None:
    rows = measured_impacts(toy).to_pylist()
    assert len(rows) > 20
    off = [abs(row["restitution"] - RESTITUTION) <= row["restitution_error"] for row in rows]
    assert np.mean(off) > 0.9  # some impacts continue in a contact with another body
    assert np.median([row["restitution"] for row in rows]) == pytest.approx(RESTITUTION, abs=2e-3)
    slides = [row for row in rows if row["mode"] == "sliding" and row["friction_error"] < 0.05]
    assert slides and all(row["friction"] == pytest.approx(FRICTION, abs=row["friction_error"]) for row in slides)
    assert all(row["friction"] < FRICTION + row["friction_error"] for row in rows)


def test_an_impact_loses_the_energy_that_its_two_bodies_lose(toy: Recording) -> None:
    impacts = measured_impacts(toy).to_pylist()
    touched = [(row["step"], body) for row in impacts for body in (row["i"], row["j"])]
    row = next(
        row for row in impacts if sum(at in touched for at in ((row["step"], row["i"]), (row["step"], row["j"]))) == 2
    )
    before, after = toy.checkpoints([row["step"] - 1, row["step"]])
    ends = [row["i"], row["j"]]
    inertia = 0.4 * MASS * RADIUS**2

    def energy(velocity: np.ndarray, spin: np.ndarray) -> float:
        return float(0.5 * MASS * (velocity**2).sum() + 0.5 * inertia * (spin**2).sum())

    free = energy(before.velocity[ends] + G * DT, _of(before.angular_velocity, ends))
    lost = free - energy(after.velocity[ends], _of(after.angular_velocity, ends))
    fall = MASS * 9.81 * DT * 2.0 * np.abs(after.velocity[ends]).max()  # the field may act after the impact
    assert row["j"] < 12 and row["energy_lost"] == pytest.approx(lost, abs=fall)


def test_contacts_of_a_frame_have_approach_and_loss_although_the_engine_reports_none(toy: Recording) -> None:
    impact = measured_impacts(toy).to_pylist()[0]
    rows = measured_contacts(toy, impact["time"]).to_pylist()
    (row,) = (row for row in rows if (row["i"], row["j"]) == (impact["i"], impact["j"]))
    assert row["mode"] == "impact" and row["energy_lost"] == pytest.approx(impact["energy_lost"])
    assert row["approach_speed"] > 0.0 and row["normal_impulse"] == pytest.approx(impact["normal_impulse"])
    said = command("contacts", str(toy.path), "--impacts", cwd=toy.path.parent)
    assert said.returncode == 0 and " e " in said.stdout and "μ" in said.stdout


def test_a_frame_of_an_engine_becomes_a_scene_with_its_exact_state_and_measured_coefficients(
    toy: Recording, tmp_path: Path
) -> None:
    said = command("new", "case", "--from", str(toy.path), "--step", "9", cwd=tmp_path)
    assert said.returncode == 0
    scene = Scene.load(tmp_path / "case.toml")
    start, (state,) = place(scene), toy.checkpoints([9])
    for made, there in (
        (start.position, state.position),
        (start.velocity, state.velocity),
        (start.angular_velocity, _of(state.angular_velocity, list(range(12)))),
        (start.mass, toy.bodies.mass),
        (start.radius, toy.bodies.radius),
    ):
        assert np.array_equal(made, there)
    assert tuple(scene.gravity.uniform) == tuple(G) and scene.gravity.constant == 0.0
    assert scene.plane[0].name == "floor" and tuple(scene.plane[0].normal) == (0.0, 0.0, 1.0)
    for surface in (scene.contact, scene.plane[0]):
        assert surface.restitution == pytest.approx(RESTITUTION, abs=0.02)


def test_a_frame_of_carom_becomes_a_scene_with_its_exact_state(tmp_path: Path) -> None:
    own = tmp_path / "own.rrd"
    carom.run(
        Scene.from_dict({"time": {"duration": 0.1, "fixed_dt": 0.01}, "body": [{"velocity": [1.0, 0.0, 0.0]}]}), own
    )
    said = command("new", "case", "--from", str(own), "--step", "7", cwd=tmp_path)
    assert said.returncode == 0
    start = place(Scene.load(tmp_path / "case.toml"))
    there = carom.rerun(own, 0.07).bodies(0.07)
    assert np.array_equal(start.position, np.stack([there[axis].to_numpy() for axis in "xyz"], axis=1))


@pytest.mark.parametrize(
    ("impacts", "friction"),
    [
        ([("sliding", 0.3, 0.035), ("sliding", 0.137, 0.035), ("sticking", 0.1, 0.001)], 0.3),
        ([("sliding", 0.108, 0.107), ("sticking", 0.213, 0.004), ("sticking", 0.25, 0.1)], 0.209),
        ([("sticking", np.nan, np.nan)], None),
    ],
)
def test_a_scene_of_a_frame_has_no_less_friction_than_impacts_that_stuck(
    impacts: list[tuple[str, float, float]], friction: float | None
) -> None:
    mode, measured, errors = zip(*impacts, strict=True)
    table = {"mode": mode, "friction": measured, "friction_error": errors}
    for name in ("restitution", "restitution_error"):
        table[name] = (np.nan,) * len(impacts)
    assert _measured(pa.table(table)).get("kinetic_friction") == friction
