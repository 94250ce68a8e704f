import itertools
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from carom.display.body_colours import fixed_colours
from carom.errors import RecordingError
from carom.lab.diff import _short
from carom.lab.diff.diff import Diff, _nearest_in_order, diff, differing, impact_divergence, overlay
from carom.recording.edit.clip import clip
from carom.recording.read.entities import Entities
from carom.recording.read.recording import Recording
from carom.recording.rrd.container import Container
from carom.recording.write.recorder import FrameRecorder
from carom.runs.run import run
from carom.scene.load import Scene
from edited_recordings import changed, without_column
from scripted_run import ScriptedRun
from small_scenes import scene_of

Change = Callable[[float], float]  # simulated time (s) → how far bodies are moved (m)

BODIES = 20
PATTERN = np.sin(np.arange(3 * BODIES)).reshape(BODIES, 3)
RMS = float(np.sqrt(np.mean(np.sum(PATTERN**2, axis=1))))


def record(path: Path, change: Change = lambda t: 0.0, dt: float = 0.05, frames: int = 200, **header: Any) -> Recording:
    scripted = ScriptedRun(BODIES, **header)
    with FrameRecorder(path, scripted.header) as recorder:
        for frame in scripted.frames(frames, dt):
            moved = change(frame.time)
            if moved:
                position = frame.position + moved * PATTERN
                frame = replace(frame, position=position)  # noqa: PLW2901
            recorder.put(frame)
        recorder.finish("completed")
    return Recording.open(path)


def chaos(t: float) -> float:
    return float(1e-14 * np.exp(3.0 * (t - 0.5))) if t >= 0.5 else 0.0


def test_a_recording_is_the_same_as_itself_and_as_its_clip(tmp_path: Path) -> None:
    whole = record(tmp_path / "a.rrd")
    found = diff(whole, whole)
    assert found.same and found.scene == {} and found.environment == {}
    clip(whole.path, tmp_path / "clip.rrd", 2.0, 3.0)
    piece = diff(whole, Recording.open(tmp_path / "clip.rrd"))
    assert piece.same and len(piece.curve.step) == 21 and piece.frames == (200, 21)


def test_exponential_growth_is_measured_through_exact_states_and_single_precision(tmp_path: Path) -> None:
    found = diff(record(tmp_path / "a.rrd"), record(tmp_path / "b.rrd", chaos))
    assert found.matched_by == "step"
    assert found.verdict.kind == "chaos"
    assert found.verdict.first == 10 and found.curve.time[10] == pytest.approx(0.5)
    assert found.divergence is not None
    assert found.divergence.rate == pytest.approx(3.0, rel=0.01), (
        "single precision rounds the least of the points by 1 in 2"
    )
    exact = found.curve.floor == 0.0
    assert 3 < exact.sum() < 100
    expected = [RMS * chaos(t) for t in found.curve.time[exact]]
    # positions of some 10 m are rounded to 2e-15 m when the pattern is added
    assert found.curve.rms[exact] == pytest.approx(expected, rel=1e-9, abs=4e-15)
    seen = found.curve.rms > found.curve.floor
    assert found.curve.rms[~seen] == pytest.approx([RMS * chaos(t) for t in found.curve.time[~seen]], abs=2e-6)


def test_a_fault_is_told_from_chaos(tmp_path: Path) -> None:
    found = diff(record(tmp_path / "a.rrd"), record(tmp_path / "b.rrd", lambda t: 1e-3 if t >= 3.0 else 0.0))
    assert found.verdict.kind == "jump"
    assert found.verdict.first == 60
    assert found.verdict.jump == pytest.approx(1e-3 * RMS, rel=1e-3)


def test_where_dt_differs_frames_are_matched_by_time(tmp_path: Path) -> None:
    found = diff(record(tmp_path / "a.rrd"), record(tmp_path / "b.rrd", dt=0.037, frames=270))
    assert found.matched_by == "sim_time"
    assert len(found.curve.step) == 200
    assert found.verdict.kind != "jump", "bodies on the same circles: only the interpolation differs"
    # Circles of at least 1 m at 3 m/s: a parabola is off by a dt²/8 = 9 · 0.037² / 8 m.
    assert np.all(found.curve.rms < 9 * 0.037**2 / 8)


def test_scenes_are_compared_key_by_key(tmp_path: Path) -> None:
    one = 'title = "x"\n[time]\nmax_dt = 1.0\n[[body]]\nradius = 1.0\n[[body]]\n'
    other = "[time]\nmax_dt = 2.0\n[[body]]\nradius = 1.0\n[[body]]\nradius = 3.0\n"
    a = record(tmp_path / "a.rrd", frames=5, scene_toml=one)
    b = record(tmp_path / "b.rrd", frames=5, scene_toml=other, properties={"version.carom": "0.2.0", "threads": 2})
    found = diff(a, b)
    assert found.same
    assert found.scene == {"title": ("x", None), "time.max_dt": (1.0, 2.0), "body.1.radius": (None, 3.0)}
    assert found.environment["version.carom"] == ("0.1.0", "0.2.0") and "threads" not in found.environment


def test_a_quantity_is_the_same_with_its_unit_and_without(tmp_path: Path) -> None:
    texts = [f"[units]\nlength = 'cm'\n[time]\nduration = {end}\n[[body]]\n[[body]]\n" for end in ("0.1", "'0.1 s'")]
    a, b = (record(tmp_path / f"{k}.rrd", frames=5, scene_toml=text) for k, text in enumerate(texts))
    assert diff(a, b).scene == {}


def test_a_missing_key_is_told_from_one_that_is_none() -> None:
    assert differing({"a": 1}, {"a": 1}) == {}
    assert differing({"a": 1}, {}) == {"a": (1, None)}


@pytest.mark.parametrize("scene", ["[time", "a = " + "[" * 5000 + "]" * 5000])
def test_a_scene_that_cannot_be_read_is_one_message(scene: str, tmp_path: Path) -> None:
    broken = record(tmp_path / "a.rrd", frames=3, scene_toml=scene)
    with pytest.raises(RecordingError, match=r"the scene in .*a\.rrd cannot be read"):
        diff(broken, broken)


def test_recordings_of_different_bodies_cannot_be_compared(tmp_path: Path) -> None:
    whole = record(tmp_path / "a.rrd", frames=10)
    clip(whole.path, tmp_path / "few.rrd", bodies=[3, 4])
    with pytest.raises(RecordingError, match="contain different bodies"):
        diff(whole, Recording.open(tmp_path / "few.rrd"))


def test_recordings_without_a_frame_in_common_cannot_be_compared(tmp_path: Path) -> None:
    whole = record(tmp_path / "a.rrd", frames=20)
    clip(whole.path, tmp_path / "early.rrd", 0.0, 0.2)
    clip(whole.path, tmp_path / "late.rrd", 0.5, 0.9)
    with pytest.raises(RecordingError, match="no frame in common"):
        diff(Recording.open(tmp_path / "early.rrd"), Recording.open(tmp_path / "late.rrd"))


def test_a_position_that_is_no_number_is_as_far_away_as_can_be(tmp_path: Path) -> None:
    a = record(tmp_path / "a.rrd", frames=10)
    b = record(tmp_path / "b.rrd", lambda t: 1e300 if t > 0.2 else 0.0, frames=10)
    found = diff(a, b)
    assert found.verdict.kind == "jump" and found.verdict.jump == np.inf


def test_a_recording_that_lost_its_total_energy_is_refused_in_one_sentence(tmp_path: Path) -> None:
    whole = record(tmp_path / "a.rrd")
    changed(whole.path, tmp_path / "b.rrd", "energy/total", lambda rows: without_column(rows, "Scalars:scalars"))
    with pytest.raises(RecordingError, match="has no /energy/total: a part of the file is missing"):
        diff(whole, Recording.open(tmp_path / "b.rrd"))


def balls(path: Path, *, speed: float = 1.0, **record: Any) -> Recording:
    """Two balls that bounce on a floor beside each other, the second one first and, if it is fast, more often."""
    bodies = [
        {"position": [0.0, 0.0, 1.5], "radius": 0.5},
        {"position": [3.0, 0.0, 1.0], "velocity": [0.0, 0.0, -speed], "radius": 0.5},
    ]
    scene = scene_of(
        bodies,
        gravity={"constant": 0.0, "uniform": [0.0, 0.0, -9.81]},
        plane=[{"point": [0.0, 0.0, 0.0]}],
        time={"duration": 1.5, "fixed_dt": 0.01},
        record={"every": 0.1} | record,
    )
    return run(scene, path)


def test_the_first_impact_at_which_two_runs_part_is_named_with_its_number_pair_and_time(tmp_path: Path) -> None:
    one, other = balls(tmp_path / "a.rrd"), balls(tmp_path / "b.rrd", speed=1.01)
    found = impact_divergence(one, other)
    assert found is not None and found.first is not None and not found.same
    table, there = one.impacts(), other.impacts()
    assert found.first.a is not None and found.first.b is not None
    assert (found.first.a.number, found.first.b.number, found.first.a.bodies) == (1, 1, (1, 2))
    assert (found.first.a.time, found.first.b.time) == (table["time"][0].as_py(), there["time"][0].as_py())
    assert found.first.b.time < found.first.a.time
    assert found.counts == (table.num_rows, there.num_rows) and 0 < found.compared <= min(found.counts)


def test_an_impact_that_only_one_run_makes_shifts_no_others(tmp_path: Path) -> None:
    # two pairs far from each other; in the second run a third ball hits one of the first pair in between
    def three(path: Path, third: float) -> Recording:
        bodies = [
            {"position": [x, y, 0.0], "velocity": [v, 0.0, 0.0], "radius": 0.5, "mass": 1.0}
            for x, y, v in ((-1.0, 0.0, 1.0), (1.0, 0.0, -1.0), (-3.0, 9.0, 1.0), (3.0, 9.0, -1.0), (-9.0, 0.0, third))
        ]
        scene = scene_of(bodies, gravity={"constant": 0.0}, contact={"restitution": 1.0}, time={"duration": 4.0})
        return run(scene, path)

    one, other = three(tmp_path / "a.rrd", 0.0), three(tmp_path / "b.rrd", 6.0)
    found = impact_divergence(one, other)
    assert found is not None and found.counts == (2, 4)
    assert found.compared == 2 and found.first is None, "0.5 s and 2.5 s are the same in both"
    assert found.alone is not None and found.alone.a is None and found.alone.b is not None
    assert found.alone.b.number == 2 and found.alone.b.bodies == (0, 4)
    swapped = impact_divergence(other, one)
    assert swapped is not None and swapped.alone is not None and swapped.alone.a == found.alone.b


@pytest.mark.parametrize("seed", range(4))
def test_of_more_impacts_those_are_matched_whose_times_are_nearest(seed: int) -> None:
    rng = np.random.default_rng(seed)
    long = np.sort(rng.uniform(0.0, 10.0, 7))
    short = np.sort(rng.uniform(0.0, 10.0, 4))
    chosen = _nearest_in_order(short, long)
    least = min(np.abs(long[list(rows)] - short).sum() for rows in itertools.combinations(range(7), 4))
    assert np.abs(long[chosen] - short).sum() == pytest.approx(least) and (np.diff(chosen) > 0).all()


def test_of_a_run_that_recorded_fewer_frames_and_impacts_those_in_both_are_the_same(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = balls(tmp_path / "a.rrd")
    monkeypatch.setattr("carom.recording.write.impact_plan.SHARE", 1e-6)
    found = diff(whole, balls(tmp_path / "b.rrd", every=0.5))
    assert found.same and found.impacts is not None
    assert 0 < found.impacts.compared < whole.impacts().num_rows and found.impacts.same


def test_impacts_that_one_run_did_not_record_are_not_compared(tmp_path: Path) -> None:
    assert diff(balls(tmp_path / "a.rrd"), balls(tmp_path / "b.rrd", impacts="none")).impacts is None


def test_across_a_periodic_boundary_bodies_are_near(tmp_path: Path) -> None:
    box = np.full(3, 40.0)
    a = record(tmp_path / "a.rrd", frames=10, box=box)
    shifted = 40.0 / PATTERN[0, 1]  # moves the first body by one side of the box
    b = record(tmp_path / "b.rrd", lambda t: shifted if t > 0.2 else 0.0, frames=10, box=box)
    assert diff(a, b).curve.rms.max() <= np.sqrt(3) * 20.0


def test_the_overlay_shows_both_and_a_line_where_they_part(tmp_path: Path) -> None:
    a, b = record(tmp_path / "a.rrd"), record(tmp_path / "b.rrd", chaos)
    overlay(a, b, diff(a, b), tmp_path / "both.rrd")
    both = Recording.open(tmp_path / "both.rrd")
    assert both.finished and both.is_overlay and both.frames == 200 and both.layout()
    with pytest.raises(RecordingError, match="is outside"):
        both.moment(-1.0)
    paths = {entry.entity_path for entry in both.store.entries}
    assert paths >= {"world/a/bodies", "world/b/bodies", "world/apart", "difference/rms", "difference/energy"}
    entities = Entities(Container.open(both.path), both.store)
    first, second = (entities.static(f"world/{run}/bodies")["Ellipsoids3D:colors"] for run in "ab")
    assert list(first) == list(second) == fixed_colours(a).tolist(), "a body has one colour in both runs and in its own"


def test_the_bodies_of_an_overlay_are_refused_because_it_shows_several_runs(tmp_path: Path) -> None:
    a, b = record(tmp_path / "a.rrd"), record(tmp_path / "b.rrd", chaos)
    overlay(a, b, diff(a, b), tmp_path / "both.rrd")
    both = Recording.open(tmp_path / "both.rrd")
    reads = (lambda: both.bodies, lambda: both.bodies(0.1), lambda: both.trajectory(0), lambda: diff(a, both))
    for read in reads:
        with pytest.raises(RecordingError, match=r"both\.rrd contains several runs and can only be viewed"):
            read()
    with pytest.raises(RecordingError, match="contains several runs"):
        both.summary()
    last = [e for e in both.store.entries if e.entity_path == "world/apart" and not e.is_static][-1]
    (chunk,) = both.chunks([last])
    lines = [len(row) for row in chunk.batch["LineStrips3D:strips"]]
    assert lines[0] == 0 and lines[-1] > 0


@pytest.fixture(scope="module")
def gas(tmp_path_factory: pytest.TempPathFactory) -> Diff:
    """Elastic gas, and the same with one body a picometre to the side."""
    folder = tmp_path_factory.mktemp("gas")
    scene = {
        "time": {"duration": 12.0, "max_dt": 0.01},
        "gravity": {"constant": 0.0},
        "contact": {"restitution": 1.0, "static_friction": 0.0, "kinetic_friction": 0.0},
        "domain": {"boundary": "periodic", "size": [8.0, 8.0, 8.0]},
        "record": {"every": 0.05},
        "body": [
            {"position": [x, y, z], "velocity": [1.0 - 0.3 * y, 0.7 * x - z, 0.4 * z - x], "radius": 0.5}
            for x in (-2.5, 0.0, 2.5)
            for y in (-2.5, 0.0, 2.5)
            for z in (-2.5, 0.0, 2.5)
        ],
    }
    a = run(Scene.from_dict(scene), folder / "a.rrd")
    scene["body"][13]["position"] = [1e-12, 0.0, 0.0]  # type: ignore[index]
    return diff(a, run(Scene.from_dict(scene), folder / "b.rrd"))


def test_a_gas_of_spheres_is_chaotic(gas: Diff) -> None:
    assert list(gas.scene) == ["body.13.position"]
    assert gas.verdict.kind == "start"
    assert gas.verdict.jump == pytest.approx(1e-12 / np.sqrt(27), rel=1e-3)
    assert gas.divergence is not None and gas.divergence.is_exponential
    assert gas.divergence.factor > 1e6
    assert "e^(λt)" in gas.verdict.text


def test_a_key_that_one_scene_does_not_write_differs_from_what_holds_there(tmp_path: Path) -> None:
    body = '[[body]]\nname = "x"\n'
    plain = record(tmp_path / "a.rrd", scene_toml=body, frames=2)
    written = "seed = 3\n[time]\nduration = 10.0\n[expect]\nmax_overlap = 0.1\n"
    other = record(tmp_path / "b.rrd", scene_toml=f"{written}{body}radius = 2.0\n[[body]]\nradius = 3.0\n", frames=2)
    found = diff(plain, other)
    assert found.scene == {
        "seed": (None, 3),
        "expect.max_overlap": (None, 0.1),
        "body.0.radius": (None, 2.0),
        "body.1.radius": (None, 3.0),
    }, "the duration is what holds in the other scene, too"
    assert found.defaults == {"seed": 0, "time.duration": 10.0, "body.0.radius": 1.0}
    assert _short(None, found.defaults["seed"]) == "0 by default" and _short(None) == "nothing"


def falling(path: Path, dt: float, pull: float) -> Recording:
    """A ball that falls for 0.6 s, recorded each tenth of a second."""
    time = {"duration": 0.6, "fixed_dt": dt}
    field = {"constant": 0.0, "uniform": [0.0, 0.0, -pull]}
    return run(scene_of([{"radius": 1.0}], time=time, gravity=field, record={"every": 0.1}), path)


def test_runs_whose_steps_share_only_the_start_are_compared_by_time(tmp_path: Path) -> None:
    # Frames are at steps 10, 20 … of one, and at 15, 29, 43, 58, 72 and 86 of the other.
    found = diff(falling(tmp_path / "a.rrd", 0.01, 9.81), falling(tmp_path / "b.rrd", 0.007, 5.0))
    assert found.matched_by == "sim_time" and not found.same
    assert len(found.curve.step) == 7
    assert found.curve.rms[-1] == pytest.approx(0.5 * (9.81 - 5.0) * 0.6**2, rel=0.01)


def test_one_run_recorded_at_two_intervals_is_compared_by_step(tmp_path: Path) -> None:
    time, field = {"duration": 1.0, "fixed_dt": 0.01}, {"constant": 0.0, "uniform": [0.0, 0.0, -9.81]}
    scenes = (scene_of([{"radius": 1.0}], time=time, gravity=field, record={"every": every}) for every in (0.3, 0.2))
    a, b = (run(scene, tmp_path / f"{k}.rrd") for k, scene in enumerate(scenes))
    found = diff(a, b)
    assert found.matched_by == "step" and found.same
