"""Bodies at rest are drawn once, and lines to them end at them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rerun.chunk import RrdReader

from carom.errors import RecordingError
from carom.recording.read.recording import Recording
from carom.recording.schema.series import Sample, Series
from carom.runs.run import run
from carom.scene.load import Scene

PLANES = [{"name": "floor", "point": [0.0, 0.0, -2.0]}, {"name": "ramp", "point": [0, 0, -2], "normal": [1, 0, 2]}]


def recorded(path: Path, **sections: Any) -> Path:
    body = {"position": [0.0, 0.0, 0.5], "velocity": [0.1, 0.0, -1.0], "radius": 0.5, "mass": 1.0}
    document = {
        "time": {"duration": 4.0, "max_dt": 0.02},
        "gravity": {"constant": 0.0},
        "record": {"every": "step"},
        "body": [body, {"position": [0.0, 2.0, 2.0], "radius": 0.5, "mass": 1.0}],
    }
    run(Scene.from_dict(document | sections), path)
    return path


def rows(path: Path, entity: str, component: str) -> list[Any]:
    return [
        row
        for chunk in RrdReader(path).store().stream().filter(content=f"/{entity}")
        if component in (batch := chunk.to_record_batch()).schema.names
        for row in batch[component].to_pylist()
    ]


def entities(path: Path) -> set[str]:
    return {chunk.entity_path for chunk in RrdReader(path).store().stream()}


def test_planes_are_drawn_as_grids_that_lie_in_them(tmp_path: Path) -> None:
    path = recorded(tmp_path / "x.rrd", plane=PLANES)
    assert "/world/planes" in entities(path) and not {"/world/walls", "/world/box"} & entities(path)
    (strips,) = rows(path, "world/planes", "LineStrips3D:strips")
    lines = np.array(strips)
    assert lines.shape == (2 * 26, 2, 3)  # 13 lines each way
    origin = np.array([0.0, 1.0, 1.25])  # the centre of mass of frame 0
    for grid, plane in zip((lines[:26], lines[26:]), PLANES, strict=True):
        height = (grid + origin - np.array(plane["point"])) @ np.array(plane.get("normal", [0.0, 0.0, 1.0]))
        assert np.abs(height).max() <= 1e-5  # float32 of numbers of order 10
        edge = np.linalg.norm(grid[0, 1] - grid[0, 0])
        assert edge > 2.0, "as wide as the bodies are apart"


def test_walls_and_a_periodic_domain_are_a_box(tmp_path: Path) -> None:
    for boundary, entity, other in (("walls", "walls", "box"), ("periodic", "box", "walls")):
        domain = {"boundary": boundary, "size": [6.0, 7.0, 8.0]}
        path = recorded(tmp_path / f"{boundary}.rrd", domain=domain)
        assert f"/world/{entity}" in entities(path)
        assert not {f"/world/{other}", "/world/planes"} & entities(path)
        (half_sizes,) = rows(path, f"world/{entity}", "Boxes3D:half_sizes")
        (centres,) = rows(path, f"world/{entity}", "Boxes3D:centers")
        assert half_sizes == [[3.0, 3.5, 4.0]]
        assert centres == [[0.0, -1.0, -1.25]], "relative to the centre of mass of frame 0"


def test_without_planes_nothing_of_the_kind_is_in_the_file(tmp_path: Path) -> None:
    assert not {"/world/planes", "/world/walls", "/world/box"} & entities(recorded(tmp_path / "x.rrd"))


def test_a_line_to_a_plane_ends_at_the_foot_of_the_perpendicular(tmp_path: Path) -> None:
    path = recorded(tmp_path / "x.rrd", plane=PLANES[:1])
    drawn = [strip for frame in rows(path, "world/contacts", "LineStrips3D:strips") for strip in frame]
    centre, foot = np.array(drawn).transpose(1, 0, 2)
    assert len(drawn) == 2 and drawn[0] == drawn[1], "it bounces once: a row at its instant, and one of the step"
    assert np.array_equal(centre[:, :2], foot[:, :2])
    assert np.allclose(foot[:, 2], -2.0 - 1.25, rtol=0, atol=1e-6)  # float32


def test_momentum_errors_that_are_not_compared_are_no_numbers(tmp_path: Path) -> None:
    path = recorded(tmp_path / "x.rrd", plane=PLANES[:1])
    momentum = Recording.open(path).momentum()
    for name in ("momentum_error", "angular_momentum_error"):
        assert np.isnan(np.array(momentum[name].to_pylist(), dtype=float)).all()
    summary = Recording.open(path).summary()
    assert summary["momentum"]["max_error"] is None and summary["angular_momentum"]["max_error"] is None
    assert summary["contacts"]["total"] == 1


def test_a_series_has_the_masses_and_its_failure_names_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[float] = []

    def value(sample: Sample) -> float:
        seen.extend([*sample.mass, *sample.radius])
        raise ZeroDivisionError("no ratio")

    series = Series("step/ratio", "1", "ratio", 0, None, value, "a ratio")
    monkeypatch.setattr("carom.recording.write.encoder.recorded", lambda header: [series])
    with pytest.raises(RecordingError, match=r"the series step/ratio: ZeroDivisionError: no ratio$"):
        recorded(tmp_path / "x.rrd")
    assert seen[:4] == [1.0, 1.0, 0.5, 0.5]


def test_edges_end_on_planes_and_the_overlap_counts_against_the_body(tmp_path: Path) -> None:
    path = recorded(tmp_path / "x.rrd", plane=PLANES[:1], contact={"timing": "end-of-step"})
    relative = rows(path, "step/relative_overlap", "Scalars:scalars")
    absolute = rows(path, "step/overlap", "Scalars:scalars")
    assert np.max(relative) == pytest.approx(np.max(absolute) / 0.5, rel=1e-15)
    assert 0.0 < np.max(relative) <= 0.02 * 1.0 / 0.5  # at most v dt deep
