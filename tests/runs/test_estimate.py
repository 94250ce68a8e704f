"""The cost of a run is estimated from a few of its steps and frames, and its parts add up."""

from __future__ import annotations

import math
import re
import time
from pathlib import Path
from typing import Any

import numba
import pytest
from rerun.chunk import RrdReader

import carom
from carom.physics.space import Space
from carom.physics.time_step import Timestep
from carom.plan.features import own_kernels
from carom.plan.room import resident_memory
from carom.recording.read.recording import Recording
from carom.recording.schema.series import contents
from carom.runs.estimate import MARKS, RECORDER_BYTES, Estimate, _first_frames, estimate
from carom.runs.outlook import estimate_steps, flight_seconds
from carom.runs.run import header_of, recording_space, run
from carom.runs.stopwatch import TrialClock
from carom.scene.load import Scene
from carom.scene.parts import PARTS
from carom.state.frame import Frame
from small_scenes import cloud, pair, scene_of

SMOOTH = {"static_friction": 0}
FALLING = {"constant": 0.0, "uniform": [0.0, 0.0, -9.81]}
SHORT: dict[str, Any] = {"time": {"duration": 0.2}}
SCENES = {
    "the whole model": cloud(gravity={"constant": 1.0, "uniform": [0.0, 0.0, -1.0]}, **SHORT),
    "a smooth gas": pair(contact=SMOOTH, **SHORT),
    "a smooth gas that spins": cloud(contact=SMOOTH, gravity={"constant": 0.0}, **SHORT),
    "a smooth gas with friction forced on": pair(contact=SMOOTH, model={"force": "friction"}, **SHORT),
    "a smooth gas with spin forced on": pair(contact=SMOOTH, model={"force": "spin"}, **SHORT),
    "a body that falls on a floor": scene_of([{"position": [0, 0, 2]}], plane=[{}], gravity=FALLING, **SHORT),
    "a body between walls": scene_of([{}], domain={"boundary": "walls", "size": [9, 9, 9]}, **SHORT),
    "a periodic box": pair(domain={"boundary": "periodic", "size": [9, 9, 9]}, **SHORT),
    "nothing but motion": scene_of([{"velocity": [1, 0, 0]}], **SHORT),
}


def test_the_compilation_of_a_kernel_during_the_measured_steps_is_no_cost_of_the_run(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    measured = []

    def first_frames(space: Space, clock: TrialClock) -> list[Frame]:
        frames = _first_frames(space, clock)
        measured.append((frames[0].step, frames[-1].fingerprint))
        if len(measured) == 1:  # as the first impact does
            numba.njit(lambda x: x)(float(len(frames)))
        return frames

    monkeypatch.setattr("carom.runs.estimate._first_frames", first_frames)
    estimate(SCENES["a smooth gas"])
    assert len(measured) == 2 and measured[0] == measured[1]


@pytest.mark.parametrize("name", SCENES)
def test_a_recording_has_the_entities_that_the_scene_requires_and_no_other(name: str, tmp_path: Path) -> None:
    scene, path = SCENES[name], tmp_path / "x.rrd"
    run(scene, path)
    space = recording_space(scene)
    entities = contents(header_of(space), space.requirements)
    expected = {f"/{entity}" for entity, recorded, _ in entities if recorded}
    # a run without an impact has no row of one
    if "/impacts" in expected and Recording.open(path).impacts().num_rows == 0:
        expected -= {"/impacts", "/impacts/spins"}
    chunks = RrdReader(path).store().stream()
    assert {chunk.entity_path for chunk in chunks if not chunk.entity_path.startswith("/__")} == expected


def test_checkpoints_lack_the_parts_that_are_not_required(tmp_path: Path) -> None:
    for name, orientations, spins in (
        ("a smooth gas", False, False),
        ("a smooth gas with spin forced on", False, True),
        ("a smooth gas that spins", True, True),
    ):
        path = tmp_path / f"{name}.rrd"
        run(SCENES[name], path)
        checkpoint = Recording.open(path).checkpoint(0)
        assert (checkpoint.orientation is not None, checkpoint.angular_velocity is not None) == (orientations, spins)
        assert checkpoint.contacts is None


@pytest.fixture(scope="module")
def whole() -> Estimate:
    return estimate(SCENES["the whole model"])


def test_every_part_has_a_share_or_the_name_of_the_part_that_has_it(whole: Estimate) -> None:
    assert [part.name for part in whole.parts] == list(PARTS)
    shares = {part.name: part.share for part in whole.parts if part.share is not None}
    for part in whole.parts:
        assert (part.name in shares) == (part.modelled and part.within is None)
        assert part.within is None or part.within in shares
    assert sum(shares.values()) == pytest.approx(1.0, rel=1e-12)
    assert min(shares.values()) >= 0.0


def test_every_mark_of_the_profile_belongs_to_a_part() -> None:
    assert {part for parts in MARKS.values() for part in parts} <= {*PARTS, "release"}  # only where bodies pass
    sources = [path.read_text() for path in (Path(carom.__file__).parent / "physics").rglob("*.py")]
    marks = {mark for source in sources for mark in re.findall(r'\.mark\("([\w-]+)"\)', source)}
    assert len(marks) > 8 and marks <= set(MARKS)


@pytest.mark.slow
def test_the_cost_of_a_scene_with_sleep_is_estimated() -> None:
    scene = Scene.from_dict(
        {
            "time": {"duration": 1.0, "fixed_dt": 0.01},
            "gravity": {"constant": 0.0, "uniform": [0.0, 0.0, -9.81]},
            "contact": {"sleep": {"speed": 0.02}},
            "plane": [{}],
            "body": [{"radius": 0.5, "position": [0.0, 0.0, 1.0]}],
        }
    )
    assert sum(part.share or 0.0 for part in estimate(scene).parts) == pytest.approx(1.0, rel=1e-12)


def test_every_entity_has_its_share_of_the_bytes(whole: Estimate) -> None:
    assert sum(entity.share or 0.0 for entity in whole.entities) == pytest.approx(1.0, rel=1e-12)
    for entity in whole.entities:
        assert (entity.share is not None) == entity.recorded
        assert entity.recorded or entity.bytes == entity.seconds == 0.0
    largest = max(whole.entities, key=lambda entity: entity.bytes)
    assert largest.path == "world/bodies"


def test_the_size_of_the_recording_is_foretold(whole: Estimate, tmp_path: Path) -> None:
    recording = run(SCENES["the whole model"], tmp_path / "x.rrd")
    assert whole.cost.frames == pytest.approx(recording.frames, rel=0.5), "at the pace of the first steps"
    each = (tmp_path / "x.rrd").stat().st_size / whole.cost.size
    assert 0.5 < each < 2.0  # a constant of 300 kB for layout and footer is most of it


def test_frames_are_foreseen_where_some_steps_are_longer_than_a_frame_and_others_shorter(tmp_path: Path) -> None:
    comet = Scene.from_dict(
        {
            "body": [
                {"mass": 1.0, "radius": 1e-3, "position": [0, 0, 0]},
                {"mass": 0.0, "radius": 1e-4, "position": [1.99, 0, 0], "velocity": [0, 0.0501, 0]},  # e = 0.995
            ],
            "gravity": {"constant": 1.0},
            "contact": {"enabled": False},
            "time": {"duration": 12.0, "integrator": "gauss-radau15"},
        }
    )
    recorded = run(comet, tmp_path / "x.rrd").frames
    assert recorded < 200, "120 of the 600 frames of an automatic recording"
    assert estimate(comet).cost.frames == pytest.approx(recorded, rel=0.25)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["cloud-collapse", "piston", "heap"])  # whose contacts come late, last, or end
def test_the_size_of_a_recording_is_foretold_by_frames_of_the_whole_run(name: str, tmp_path: Path) -> None:
    scene = Scene.load(name)
    run(scene, tmp_path / "x.rrd")
    size = (tmp_path / "x.rrd").stat().st_size
    # 1.1, 1.1 and 1.6: equal frames of a heap at rest compress more. By the first frames: 0.5, 0.4 and 2.1
    assert 0.8 < estimate(scene).cost.size / size < 1.8


def test_a_scene_as_short_as_a_step_is_estimated() -> None:
    scene = scene_of([{"velocity": [1, 0, 0]}], time={"duration": 1e-3}, record={"every": "auto"})
    found = estimate(scene)
    assert found.cost.steps >= 1 and found.cost.seconds > 0.0


def test_the_cost_leaves_out_what_the_first_step_loads(monkeypatch: pytest.MonkeyPatch) -> None:
    choose, waits = Timestep.choose, [0.5]  # s, ten times what the 200 steps of this estimate take

    def choose_slowly_at_first(*given: Any) -> tuple[float, str]:
        time.sleep(waits.pop() if waits else 0.0)
        return choose(*given)

    monkeypatch.setattr(Timestep, "choose", choose_slowly_at_first)
    few = cloud(gravity={"constant": 0.0}, contact=SMOOTH, time={"duration": 0.2})
    shares = {part.name: part.share for part in estimate(few).parts}
    assert shares["adaptive-step"] is not None and shares["adaptive-step"] < 0.8  # 0.9 with the wait


def test_no_fewer_steps_are_foreseen_than_the_longest_step_allows(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("carom.runs.outlook.LOOK_SECONDS", 0.1)
    million_years = 3.15576e13
    scene = cloud(10, gravity={"constant": 1e-9}, time={"duration": million_years, "max_dt": 1.0})
    assert estimate_steps(scene, 1e-5).fewest >= 0.999 * million_years


def test_a_bundled_scene_that_is_forced_says_so() -> None:
    scene = Scene.load("elastic-gas", ["model.force=friction"])
    costs = {part.name: part for part in estimate(scene).parts}
    assert costs["friction"].why == "forced; otherwise not: both coefficients are 0"
    assert costs["spin"].modelled and costs["torque"].share is not None


def test_steps_where_nothing_touches_cost_what_they_do_in_a_run_that_takes_many_in_one_call() -> None:
    short = {"duration": 0.2, "max_dt": 1e-4}
    apart = scene_of([{}, {"position": [9, 0, 0]}], gravity={"constant": 0.0}, time=short)
    found = estimate_steps(apart, 1.0, flight_seconds=1e-12)
    assert found.seconds <= 1e-12 * found.steps * (1.0 + 1e-9)
    lying = scene_of([{"position": [0, 0, 1]}], plane=[{}], gravity=FALLING, **SHORT)
    found = estimate_steps(lying, 1.0, flight_seconds=1e-12)
    assert found.seconds > 1e-9 * found.steps, "a contact ends such a call"


def test_the_cost_of_a_step_where_nothing_touches_is_measured_for_few_bodies_only() -> None:
    few = Space(scene_of([{"velocity": [1, 0, 0]}], time={"duration": 5.0, "fixed_dt": 1e-3}))
    few.compute_dynamics(1)
    assert 0.0 < flight_seconds(few) < math.inf
    many = Space(SCENES["a smooth gas that spins"])
    assert flight_seconds(many) == math.inf


RESTING = {
    "three that come to rest on each other": scene_of(
        [
            {"position": [0.3, 0.9, 0.0], "mass": 3.0, "radius": 0.05},
            {"position": [-0.6, -0.3, 0.0], "mass": 4.0, "radius": 0.05},
            {"position": [0.3, -0.3, 0.0], "mass": 5.0, "radius": 0.05},
        ],
        gravity={"constant": 1.0},
        time={"duration": 2.5},
        record={"every": "auto"},
    ),
    "a planet and its moon": scene_of(
        [
            {"density": 3000.0, "radius": 50.0},
            {"position": [200.0, 0.0, 0.0], "velocity": [0.0, 0.012, 0.0], "density": 3000.0, "radius": 10.0},
        ],
        time={"duration": 30_000.0, "max_dt": 100.0},
        record={"every": "auto"},
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", RESTING)
def test_the_steps_of_bodies_that_come_to_rest_are_foreseen_to_a_factor_of_two(name: str) -> None:
    scene = RESTING[name]
    space = Space(scene)
    for _ in space.run():
        pass
    found = estimate(scene).cost
    assert found.fewest_steps <= space.step <= found.most_steps
    if found.looked_until == scene.time.duration:  # on a machine that is busy the look may not reach the end
        assert 0.5 < found.steps / space.step < 2.0
        assert "acceleration" in found.limits
        if name != "a planet and its moon":  # the moon slides on, and rebounds a little, until the end
            assert "held" in found.limits


@pytest.mark.nightly
@pytest.mark.slow
def test_the_steps_of_contacts_at_rest_that_gauss_radau15_leaves_to_leapfrog_are_foreseen() -> None:
    scene = scene_of(
        [{"position": [0.0, 0.0, 1.0], "radius": 0.5}, {"position": [0.0, 0.0, 2.2], "radius": 0.5}],
        gravity={"constant": 0.0, "uniform": [0.0, 0.0, -9.81]},
        contact={"restitution": 0.0},
        time={"duration": 3.0, "accuracy": 1e-4},
        plane=[{}],
    )
    space = Space(scene)
    for _ in space.run():
        pass
    found = estimate(scene).cost
    assert found.fewest_steps <= space.step <= found.most_steps
    assert "error" in found.limits and len(found.limits) > 1


@pytest.mark.parametrize("name", ["two-spheres", "newtons-cradle", "rack-break", "figure-eight", "kepler-orbits"])
def test_the_steps_of_a_bundled_scene_are_foreseen_to_a_factor_of_two(name: str) -> None:
    scene = Scene.load(name)
    space = Space(scene)
    for _ in space.run():
        pass
    found = estimate_steps(scene, 1e-5)
    assert found.fewest <= space.step <= found.most
    assert 0.5 < found.steps / space.step < 2.0


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "steps"),  # as counted in whole runs
    [("rubble-collision", 1239), ("planet-with-gravel", 1955), ("marbles-in-a-box", 4039), ("cloud-collapse", 1128)],
)
def test_the_steps_of_a_large_bundled_scene_are_foreseen_to_a_factor_of_two(name: str, steps: int) -> None:
    found = estimate_steps(Scene.load(name), 1e-2)
    assert 0.5 < found.steps / steps < 2.0


def test_the_cost_of_a_run_is_that_of_its_start_its_steps_and_its_frames() -> None:
    cost = estimate(SCENES["a smooth gas"]).cost
    parts = cost.start_seconds, cost.step_seconds, cost.frames * cost.frame_seconds
    assert min(parts) > 0.0 and cost.seconds == pytest.approx(sum(parts), rel=1e-12)


def test_the_memory_is_that_of_the_process_and_of_the_frames_that_wait(whole: Estimate) -> None:
    assert whole.cost.memory > 150e6, "Python, libraries and kernels take some 300 MB"
    long = cloud(gravity={"constant": 0.0}, record={"every": "step"}, time={"duration": 20.0, "fixed_dt": 1e-3})
    assert estimate(long).cost.memory - resident_memory() > RECORDER_BYTES + 1e6


def test_laws_and_walls_with_kernels_of_their_own_are_named() -> None:
    assert estimate(SCENES["a smooth gas"]).cost.own_kernels == []
    assert own_kernels(Scene.load("drum")) == [
        'contact.law = "rolling_resistance"',
        "[[wall]] (cylinder, disc)",
        "moving walls",
    ]
    assert own_kernels(Scene.load("shear-cell")) == ["domain.shear"]


def test_what_loads_while_a_run_is_tried_is_no_part_of_its_steps() -> None:
    with TrialClock() as clock:
        numba.njit(lambda x: x + 1.0)(
            1.0
        )  # not `inline`, which finds in the cache what an earlier run of the tests compiled
        assert clock.kernels.compiled == 1 and clock.kernels.loading >= 0.0
        assert 0.0 < clock.kernels.compiling <= clock.kernels.seconds
        assert clock.seconds < clock.all_seconds
