"""Coordination, fabric, stress and force chains of arrangements whose forces are known in closed form."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import carom
from carom import Recording
from carom.lab.statistics import Interval
from carom.lab.statistics.motion_statistics import measure_impacts, measure_stress
from carom.lab.statistics.statistic import Histogram, Statistic
from carom.lab.statistics.statistics_report import Statistics, draw
from carom.lab.statistics.structure_statistics import (
    chains_of,
    contact_counts,
    held_bodies,
    measure_forces,
    measure_network,
)
from carom.scene.units.dimension import VELOCITY
from small_scenes import scene_of

COLUMN = 10  # balls
SINGLE = 1e-6  # recorded impulses are float32


def interval_of(path: Path, start: float | None = None) -> Interval:
    return Interval.of(Recording.open(path), start, None, False, lambda _: None)


@pytest.fixture(scope="module")
def column(tmp_path_factory: pytest.TempPathFactory) -> Interval:
    """A column of balls of 1 kg and 1 m at rest on a plane, with g = 1 m/s²."""
    balls = [{"position": [0.0, 0.0, 0.5 + k], "radius": 0.5, "mass": 1.0} for k in range(COLUMN)]
    scene = scene_of(
        balls,
        time={"duration": 0.2, "fixed_dt": 0.01},
        gravity={"constant": 0.0, "uniform": [0.0, 0.0, -1.0]},
        contact={"restitution": 0.0, "static_friction": 0.0},
        plane=[{"normal": [0.0, 0.0, 1.0]}],
    )
    path = tmp_path_factory.mktemp("column") / "run.rrd"
    carom.run(scene, path)
    return interval_of(path, 0.1)  # when the forces have settled


def test_a_column_of_balls_has_vertical_fabric_of_trace_1_and_two_contacts_a_ball_but_for_the_top(
    column: Interval,
) -> None:
    values = measure_network(column).values
    assert values["coordination"].value == pytest.approx((2 * (COLUMN - 1) + 1) / COLUMN, abs=1e-12)
    assert values["fabric"].value == pytest.approx(np.diag([0.0, 0.0, 1.0]), abs=SINGLE)
    assert values["rattlers"].value == 1.0  # two contacts hold no ball in space


def test_the_stress_of_a_column_is_the_sum_of_the_weights_times_the_heights(column: Interval) -> None:
    # contact k carries COLUMN - k weights over 1 m, the one with the plane COLUMN weights over 0.5 m
    virial = sum(COLUMN - k for k in range(1, COLUMN)) + 0.5 * COLUMN
    statistic = measure_stress(column)
    assert statistic.values["stress"].value == pytest.approx(np.diag([0.0, 0.0, virial]), abs=SINGLE * virial)
    assert statistic.values["pressure"].value == pytest.approx(virial / 3, rel=SINGLE)
    assert "not divided by a volume" in statistic.note


@pytest.mark.parametrize("confined", ["plane", "field", None])
def test_a_stress_over_more_than_the_volume_of_the_bodies_says_so(tmp_path: Path, confined: str | None) -> None:
    scene = scene_of(
        [{"position": [0.0, 0.0, 0.0], "radius": 0.1, "velocity": [1.0, 0.0, 0.0]}],
        time={"duration": 0.2, "fixed_dt": 0.1},
        gravity={"constant": 0.0, "uniform": [0.0, 0.0, -1.0 if confined == "field" else 0.0]},
        domain={"boundary": "walls", "size": [2.0, 2.0, 2.0]},
        plane=[{"point": [0.0, 0.0, 0.5], "normal": [0.0, 0.0, -1.0]}] if confined == "plane" else [],
    )
    carom.run(scene, tmp_path / "run.rrd")
    note = measure_stress(interval_of(tmp_path / "run.rrd")).note
    assert ("divided by the volume of domain.size" in note) is (confined is not None)


def test_the_forces_of_a_column_rise_by_a_weight_and_its_lower_half_is_a_chain(column: Interval) -> None:
    values = measure_forces(column).values
    forces = np.arange(1.0, COLUMN + 1)
    assert values["mean_force"].value == pytest.approx(forces.mean(), rel=SINGLE)
    assert values["second_moment"].value == pytest.approx(np.mean(forces**2) / forces.mean() ** 2, rel=SINGLE)
    # the stress of ball k is that of COLUMN - k weights below and COLUMN - k - 1 above; half of them are above the mean
    assert values["chains"].value == 1.0
    assert values["chain_length"].value == values["longest_chain"].value == COLUMN / 2


@pytest.mark.needs("matplotlib")
def test_the_figure_has_a_panel_for_each_histogram_with_its_unit(column: Interval, tmp_path: Path) -> None:
    kinds = {"contacts": measure_network(column), "forces": measure_forces(column)}
    kinds["speeds"] = Statistic({}, {"speeds": Histogram.of("approach speed", np.linspace(0.0, 1.0, 50), VELOCITY)})
    draw(Statistics(column, kinds), tmp_path / "figure.svg")
    text = (tmp_path / "figure.svg").read_text(encoding="utf-8")
    for label in ("fraction of the bodies", "normal force / mean", "approach speed / m/s", "density / (m/s)⁻¹"):
        assert label in text


def test_a_bent_chain_ends_at_its_bend() -> None:
    # four balls in a row, the next at a right angle: the last ball's stress is along the other axis
    pairs = np.array([[0, 1], [1, 2], [2, 3], [3, 4], [5, 6]])
    normal = np.array([[1.0, 0, 0], [1.0, 0, 0], [1.0, 0, 0], [0, 1.0, 0], [1.0, 0, 0]])
    force = np.array([10.0, 10.0, 10.0, 9.0, 0.1])
    assert chains_of(pairs, normal, force, np.full(7, 0.5)) == [4]


CUBIC = [(1, 0, 0), (0, 1, 0), (0, 0, 1)]
FACE_CENTRED = [(1, 1, 0), (1, -1, 0), (1, 0, 1), (1, 0, -1), (0, 1, 1), (0, 1, -1)]


@pytest.mark.parametrize(("steps", "neighbours"), [(CUBIC, 6), (FACE_CENTRED, 12)])
def test_a_periodic_lattice_has_its_neighbours_and_no_rattlers(steps: list[Any], neighbours: int) -> None:
    side = 4
    place = np.stack(np.meshgrid(*[np.arange(side)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    place = place if neighbours == 6 else place[place.sum(axis=1) % 2 == 0]
    number = {tuple(each): k for k, each in enumerate(place.tolist())}
    pairs = np.array([[k, number[tuple((p + step) % side)]] for k, p in enumerate(place) for step in steps])
    moving = np.ones(len(place), dtype=bool)
    held, kept = held_bodies(pairs, moving, fewest=4)
    assert held.all() and set(contact_counts(kept, len(place)).tolist()) == {neighbours}


def test_removing_a_rattler_makes_others_rattle() -> None:
    # four balls on four planes each are held; a ball with three contacts to them and one to a loose ball is not
    planes = 6
    pairs = np.array([[k, planes + p] for k in range(4) for p in range(4)] + [[0, 4], [1, 4], [2, 4], [4, 5]])
    held, kept = held_bodies(pairs, np.ones(6, dtype=bool), fewest=4)
    assert held.tolist() == [True] * 4 + [False] * 2 and len(kept) == 16


def test_two_balls_on_a_line_have_the_pressure_of_tonks_gas(tmp_path: Path) -> None:
    # Tonks, Phys. Rev. 50, 955 (1936): p L = Σ m c²/(1 - N d/L); an impact every 4 s, 12 s
    balls: list[dict[str, Any]] = [{"radius": 0.5, "mass": 1.0, "position": [x, 0, 0]} for x in (0.0, -2.0)]
    balls[1]["velocity"] = [1.0, 0.0, 0.0]
    scene = scene_of(
        balls,
        domain={"boundary": "periodic", "size": [6.0, 5.0, 5.0]},
        time={"duration": 12.0, "fixed_dt": 0.25},
        gravity={"constant": 0.0},
        contact={"restitution": 1.0, "static_friction": 0.0},
    )
    carom.run(scene, tmp_path / "run.rrd")
    interval = interval_of(tmp_path / "run.rrd")
    stress = measure_stress(interval).values
    assert stress["stress"].value == pytest.approx(np.diag([0.5 / (1 - 2 / 6), 0, 0]) / 150.0, abs=SINGLE / 150)
    assert stress["compressibility"].value == pytest.approx(1.5, rel=SINGLE)
    rates = measure_impacts(interval)
    assert rates.values["impact_rate"].value == pytest.approx(0.25, rel=1e-12)
    assert rates.values["mean_approach_speed"].value == pytest.approx(1.0, rel=SINGLE)
    (row,) = rates.rows
    assert row["groups"] == "body and body" and row["impacts"].value == 3
