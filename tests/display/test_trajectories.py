"""Several runs in one recording can be told apart."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import rerun.blueprint as rrb

from carom import Scene, Space
from carom.display.overlays import ComparedTrajectory, write_trajectories
from carom.recording.read.entities import Entities
from carom.recording.read.recording import Recording
from carom.recording.rrd.container import Container
from carom.recording.schema import palette
from carom.recording.write.chunk_writer import Writer

RUNS = {"reference": "", "mujoco, dt = 1": "mujoco", "mujoco, dt = 2": "mujoco", "box3d, dt = 1": "box3d", "carom": ""}

Style = tuple[int, float]  # colour, and width of the curve in points


@pytest.fixture
def entities(tmp_path: Path) -> Entities:
    path = tmp_path / "runs.rrd"
    runs = [ComparedTrajectory(name, np.zeros((3, 1, 3)), np.ones(3), family) for name, family in RUNS.items()]
    write_trajectories(path, Space(Scene.load("bouncing-ball"), 1), np.arange(1.0, 4.0), runs)
    return Entities(Container.open(path), Recording.open(path).store)


@pytest.fixture
def styles(entities: Entities) -> list[Style]:
    """The style of each run's curve, that of the reference apart."""
    drawn = [entities.static(f"distance/{name}") for name in sorted(entities.below("distance"))][1:]
    return [(int(each["SeriesLines:colors"][0]), float(each["SeriesLines:widths"][0])) for each in drawn]


def test_a_body_has_one_colour_in_all_runs_and_the_wires_around_it_have_that_of_the_curve(
    entities: Entities, styles: list[Style]
) -> None:
    names = sorted(entities.below("distance"))
    fills = [int(entities.static(f"world/{name}/bodies")["Points3D:colors"][0]) for name in names]
    assert fills == [palette.LINES["grey"], *[palette.SKY] * (len(names) - 1)]
    wires = [int(entities.static(f"world/{name}/wires")["Ellipsoids3D:colors"][0]) for name in names[1:]]
    assert wires == [colour for colour, _ in styles]


@pytest.mark.parametrize(("axis", "container"), [(2, rrb.Horizontal), (0, rrb.Vertical)], ids=["falls", "slides"])
def test_curves_are_beside_bodies_that_move_up_and_down_and_below_others(
    axis: int, container: type, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    layouts: list[rrb.Blueprint] = []
    monkeypatch.setattr(Writer, "send_layout", lambda writer, layout: layouts.append(layout))
    position = np.zeros((3, 1, 3))
    position[:, 0, axis] = [0.0, 20.0, 40.0]
    runs = [ComparedTrajectory(name, position, np.ones(3)) for name in ("reference", "carom")]
    write_trajectories(tmp_path / "runs.rrd", Space(Scene.load("bouncing-ball"), 1), np.arange(1.0, 4.0), runs)
    assert isinstance(layouts[0].root_container, container)


def test_runs_of_one_engine_share_a_colour_and_those_of_others_have_another(styles: list[Style]) -> None:
    coarse, fine, box3d, own = (colour for colour, _ in styles)
    assert coarse == fine
    assert len({coarse, box3d, own}) == 3


def test_of_the_runs_of_an_engine_the_first_has_the_wider_curve(styles: list[Style]) -> None:
    assert styles[0][1] > styles[1][1]
