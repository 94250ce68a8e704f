"""Free times and free paths of bodies whose paths are known in closed form."""

from __future__ import annotations

import json
from math import pi, sqrt
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import carom
from carom import Recording
from carom.errors import RecordingError
from carom.lab.statistics import Interval
from carom.lab.statistics.motion_statistics import (
    measure_free_paths,
    measure_impacts,
    measure_stress,
    measure_velocities,
    paths_of,
)
from carom.physics.contact import contact_tap
from carom.recording.write import impact_plan
from carom.scene.load import Scene
from carom_command import carom as command
from small_scenes import scene_of

FLIGHT = {"gravity": {"constant": 0.0}, "contact": {"restitution": 1.0, "static_friction": 0.0}}
SINGLE = 1e-6  # drawn positions are float32


def interval_of(scene: Scene, folder: Path) -> Interval:
    """Record a run and return all of it."""
    carom.run(scene, folder / "run.rrd")
    return Interval.of(Recording.open(folder / "run.rrd"), None, None, False, lambda _: None)


def test_a_ball_between_two_walls_flies_the_distance_of_the_walls_less_its_diameter(tmp_path: Path) -> None:
    ball = {"radius": 0.5, "mass": 1.0, "velocity": [1.0, 0.0, 0.0]}
    walls = {"boundary": "walls", "size": [4.0, 4.0, 4.0]}
    interval = interval_of(
        scene_of([ball], domain=walls, time={"duration": 11.0, "fixed_dt": 0.25}, **FLIGHT), tmp_path
    )
    paths = paths_of(interval)
    assert paths.free_times == pytest.approx([3.0] * 3, rel=SINGLE)  # impacts at 1.5, 4.5, 7.5 and 10.5 s
    assert paths.free_paths == pytest.approx([3.0] * 3, rel=SINGLE)
    assert paths.length == pytest.approx(11.0, rel=SINGLE)
    mean = measure_free_paths(interval).values
    assert mean["mean_free_time"].value == mean["mean_free_path"].value == pytest.approx(11.0 / 4, rel=SINGLE)


def test_a_path_through_the_faces_of_a_periodic_box_is_longer_than_half_the_box(tmp_path: Path) -> None:
    # equal balls exchange their velocities: one flies 6 m - 2 m from one side of the other to its other side, then the
    # other does, and each waits while the other flies
    resting: dict[str, Any] = {"radius": 0.5, "mass": 1.0}
    moving = {"radius": 0.5, "mass": 1.0, "position": [-2.0, 0.0, 0.0], "velocity": [1.0, 0.0, 0.0]}
    balls = [resting, moving]
    box = {"boundary": "periodic", "size": [6.0, 6.0, 6.0]}
    interval = interval_of(scene_of(balls, domain=box, time={"duration": 14.0, "fixed_dt": 0.25}, **FLIGHT), tmp_path)
    paths = paths_of(interval)
    assert paths.free_times == pytest.approx([4.0] * 6, rel=SINGLE)
    assert np.sort(paths.free_paths) == pytest.approx([0.0] * 3 + [4.0] * 3, rel=SINGLE, abs=SINGLE)
    assert paths.length == pytest.approx(14.0, rel=SINGLE)


def gas(**sections: Any) -> Scene:
    """Forty balls of two kinds that fill 14 % of a periodic box and meet some 20 times each."""
    size = [2.0, 2.0, 2.0]
    kind: dict[str, Any] = {"count": 20, "region": {"shape": "box", "size": size}, "velocity": {"dispersion": 1.0}}
    return Scene.from_dict(
        {
            "seed": 1,
            "time": {"duration": 4.0},
            "gravity": {"constant": 0.0},
            "contact": {"restitution": 1.0, "static_friction": 0.0},
            "domain": {"boundary": "periodic", "size": size},
            "record": {"every": 0.5, "check_every": 1_000_000},
            "group": [{**kind, "radius": 0.2, "mass": 1.0}, {**kind, "radius": 0.18, "mass": 3.0}],
            **sections,
        }
    )


MEASURES = {"free_paths": measure_free_paths, "impacts": measure_impacts, "stress": measure_stress}


def numbers(interval: Interval) -> dict[str, Any]:
    """Return all values of the statistics of impacts with their errors, and the rows of pairs of groups."""
    found: dict[str, Any] = {}
    for kind, measure in MEASURES.items():
        statistic = measure(interval)
        for name, each in statistic.values.items():
            found |= {f"{kind}.{name}": each.value, f"{kind}.{name} ±": each.error}
        for row in statistic.rows:
            found |= {f"{row['groups']}.{name}": value.value for name, value in row.items() if name != "groups"}
    return found


@pytest.mark.parametrize("limit", ["file", "memory"])
def test_a_gas_whose_impacts_are_mostly_left_out_has_the_statistics_of_all_impacts(
    limit: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    carom.run(gas(record={"every": 0.5, "check_every": 1_000_000, "impacts": "all"}), tmp_path / "all.rrd")
    whole = Interval.of(Recording.open(tmp_path / "all.rrd"), 0.5, None, False, lambda _: None)
    if limit == "file":
        monkeypatch.setattr(impact_plan, "SHARE", 0.0)  # of the file; the largest impact of each frame is kept
    else:
        monkeypatch.setattr(contact_tap, "MOST_IMPACTS", 10)  # between two frames
    carom.run(gas(), tmp_path / "few.rrd")
    few = Interval.of(Recording.open(tmp_path / "few.rrd"), 0.5, None, False, lambda _: None)
    again = Interval.of(Recording.open(tmp_path / "few.rrd"), 0.5, None, True, lambda _: None)
    assert whole.impacts_left_out == 0 and few.impacts_left_out > 0.6 * len(whole.impacts.step) > 100
    expected, found = numbers(whole), numbers(few)
    assert found.keys() == expected.keys()
    for name in expected:
        assert np.array_equal(found[name], expected[name]), name  # the same sums in the same order
    computed = numbers(again)  # the kinetic stress is then that of more states
    assert all(np.array_equal(computed[name], expected[name]) for name in expected if not name.startswith("stress"))
    assert computed["stress.impact_pressure"] == expected["stress.impact_pressure"]
    # one by one, impulses and speeds are float32
    rows, sums = whole._sums_of(whole.impacts), whole.sums
    assert rows.impacts == sums.impacts and rows.collisions == sums.collisions
    assert rows.virial == pytest.approx(sums.virial, rel=SINGLE, abs=SINGLE * float(np.trace(sums.virial)))
    assert paths_of(whole).length == pytest.approx(sums.path, rel=SINGLE)
    assert rows.pairs.impacts.tolist() == sums.pairs.impacts.tolist() and len(rows.pairs.impacts) == 3
    # no histogram of the largest
    assert not measure_free_paths(few).histograms and not measure_impacts(few).histograms
    assert measure_free_paths(whole).histograms and measure_impacts(whole).histograms
    assert few.command_again in measure_impacts(few).note


def test_a_truncated_recording_without_sums_prints_what_to_type_instead_of_numbers(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pop = contact_tap.ContactTap.pop_impacts
    monkeypatch.setattr(impact_plan, "SHARE", 0.0)
    with monkeypatch.context() as patched:  # an older version, which recorded no sums
        patched.setattr(contact_tap.ContactTap, "pop_impacts", lambda tap: (*pop(tap)[:2], None))
        carom.run(gas(), tmp_path / "old.rrd")
    interval = Interval.of(Recording.open(tmp_path / "old.rrd"), None, None, False, lambda _: None)
    for measure in measure_free_paths, measure_impacts:
        with pytest.raises(
            RecordingError, match=r"of the \d+ impacts were not recorded.*type `carom contacts .* --rep"
        ):
            measure(interval)
    stress = measure_stress(interval)
    assert set(stress.values) == {"kinetic_pressure"} and interval.command_again in stress.note
    done = command("contacts", "old.rrd", "--statistics", "--json", cwd=tmp_path)
    kinds = json.loads(done.stdout)["statistics"]
    assert done.returncode == 0 and "--replay" in kinds["impacts"]["missing"] and "temperature" in kinds["velocities"]
    again = Interval.of(Recording.open(tmp_path / "old.rrd"), None, None, True, lambda _: None)
    assert "pressure" in measure_stress(again).values and measure_impacts(again).histograms


def test_a_dense_gas_of_which_few_impacts_are_recorded_is_that_of_carnahan_and_starling(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    count, radius, size = 250, 0.125, 2.0
    density = count / size**3
    packing = density * 4 / 3 * pi * radius**3
    contact_value = (1 - packing / 2) / (1 - packing) ** 3
    monkeypatch.setattr(impact_plan, "SHARE", 0.0)
    box = {"shape": "box", "size": [size] * 3}
    group = {"count": count, "radius": radius, "mass": 1.0, "region": box, "velocity": {"dispersion": 1.0}}
    carom.run(gas(time={"duration": 2.0}, group=[group]), tmp_path / "run.rrd")
    interval = Interval.of(Recording.open(tmp_path / "run.rrd"), 0.5, None, False, lambda _: None)
    stress, free = measure_stress(interval).values, measure_free_paths(interval).values
    recorded = len(interval.impacts.step)
    assert recorded < 0.01 * interval.sums.impacts
    # 3 %: 7000 impacts count to 1.2 %, and their virial scatters as much as their number
    assert stress["compressibility"].value == pytest.approx(1 + 4 * packing * contact_value, rel=0.03)
    free_path = 1 / (sqrt(2) * density * pi * (2 * radius) ** 2 * contact_value)
    assert free["mean_free_path"].value == pytest.approx(free_path, rel=0.04)


def test_the_temperature_and_kinetic_stress_of_a_cooling_gas_are_those_of_all_frames_not_of_its_last_state(
    tmp_path: Path,
) -> None:
    interval = interval_of(gas(contact={"restitution": 0.6, "static_friction": 0.0}), tmp_path)
    recording, step = interval.recording, interval.step
    assert len([one for one in recording.checkpoint_times if one > 0]) < len(step) - 1 == 8
    momentum = np.stack(recording.momentum()["momentum"].to_numpy(zero_copy_only=False))
    carried = (momentum**2).sum(axis=1) / (2 * recording.bodies.mass.sum())  # J, of the centre of mass
    moving = (recording.energy("translational")["translational"].to_numpy() - carried)[1:]
    assert moving[0] > 1.5 * moving[-1]
    kinetic = measure_stress(interval).values["kinetic_pressure"].value
    assert kinetic == pytest.approx(2 / 3 * moving.mean() / interval.volume, rel=1e-12)
    temperature = measure_velocities(interval).values["temperature"].value
    assert temperature == pytest.approx(2 / 3 * moving.mean() / interval.bodies, rel=1e-12)


def test_a_run_without_impacts_says_so_in_a_sentence(tmp_path: Path) -> None:
    apart: list[dict[str, Any]] = [
        {"radius": 0.5, "mass": 1.0, "position": [x, 0, 0], "velocity": [x, 0, 0]} for x in (-1.0, 1.0)
    ]
    interval = interval_of(scene_of(apart, time={"duration": 1.0, "fixed_dt": 0.5}, **FLIGHT), tmp_path)
    with pytest.raises(RecordingError, match=r"^there are no impacts from 0 to 1 s$"):
        measure_free_paths(interval)


class SoftBounces:
    """Another engine's ball between two planes 4 m apart, at 1 m/s; each bounce takes two of its steps of 0.1 s."""

    planes = (carom.record.Plane((1.0, 0.0, 0.0), -2.0), carom.record.Plane((-1.0, 0.0, 0.0), -2.0))

    def __init__(self) -> None:
        self.model = carom.record.Model(engine="soft", mass=[2.0], radius=[0.5], planes=list(self.planes))
        self.step = 0

    def state(self) -> carom.record.State:
        flights, along = divmod(self.step, 31)  # 30 steps of flight, and a step at rest at the plane
        to_right = flights % 2 == 0
        x = -1.5 + 0.1 * along if to_right else 1.5 - 0.1 * along
        turns = along == 30 or (along == 0 and flights > 0)
        velocity = 0.0 if along == 30 else 1.0 if to_right else -1.0
        contacts = np.zeros(int(turns), carom.record.CONTACT)
        at_right = x > 0.0
        contacts["i"], contacts["j"] = 0, 2 if at_right else 1
        contacts["point"], contacts["normal"] = [2.0 if at_right else -2.0, 0, 0], [1.0 if at_right else -1.0, 0, 0]
        contacts["force"] = 20.0  # N, two steps of it turn 2 kg m/s
        return carom.record.State(0.1 * self.step, [[x, 0.0, 0.0]], [[velocity, 0.0, 0.0]], contacts=contacts)


def test_a_bounce_of_another_engine_that_takes_two_steps_is_one_impact(tmp_path: Path) -> None:
    ball = SoftBounces()
    with carom.record.Recorder(ball, tmp_path / "run.rrd") as recorder:
        for ball.step in range(1, 125):
            recorder.frame()
    assert recorder.problems == []
    interval = Interval.of(Recording.open(tmp_path / "run.rrd"), None, None, False, lambda _: None)
    impacts = interval.impacts
    assert impacts.step.tolist() == [30, 61, 92, 123] and impacts.j.tolist() == [2, 1, 2, 1]
    assert impacts.speed == pytest.approx([1.0] * 4, rel=1e-12)  # of the exact states
    paths = paths_of(interval)
    assert paths.free_times == pytest.approx([3.1] * 3, rel=1e-12) and paths.free_paths == pytest.approx([3.0] * 3)
