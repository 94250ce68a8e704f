"""Several runs in one recording can be told apart."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from carom.recording.read.entities import Entities
from carom.recording.read.recording import Recording
from carom.recording.rrd.container import Container
from carom.show.overlays import ComparedTrajectory, write_trajectories

RUNS = {"reference": "", "mujoco, dt = 1": "mujoco", "mujoco, dt = 2": "mujoco", "box3d, dt = 1": "box3d", "carom": ""}

Style = tuple[int, float]  # colour, and width of the curve in points


@pytest.fixture
def styles(tmp_path: Path) -> list[Style]:
    """The style of each run's curve, that of the reference apart."""
    path = tmp_path / "runs.rrd"
    runs = [ComparedTrajectory(name, np.zeros((3, 1, 3)), np.ones(3), family) for name, family in RUNS.items()]
    write_trajectories(path, "four runs", np.arange(1.0, 4.0), np.ones(1), runs)
    entities = Entities(Container.open(path), Recording.open(path).store)
    drawn = [entities.static(f"distance/{name}") for name in sorted(entities.below("distance"))][1:]
    return [(int(each["SeriesLines:colors"][0]), float(each["SeriesLines:widths"][0])) for each in drawn]


def test_runs_of_one_engine_share_a_colour_and_those_of_others_have_another(styles: list[Style]) -> None:
    coarse, fine, box3d, own = (colour for colour, _ in styles)
    assert coarse == fine
    assert len({coarse, box3d, own}) == 3


def test_of_the_runs_of_an_engine_the_first_has_the_wider_curve(styles: list[Style]) -> None:
    assert styles[0][1] > styles[1][1]
