"""The data sent to a viewer to show a moment; no picture is rendered here."""

from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest

import carom
from carom.contact_table import CONTACT_ROW
from carom.display import close_up, close_up_camera, letters, request
from carom.display.close_up_arrows import BEFORE, IMPULSE, NORMAL, SPIN, VELOCITY
from carom.display.presentation import Presentation, _steps, asked, presentation
from carom.display.request import Request, pair_of_step
from carom.display.supplement import Trails
from carom.errors import RecordingError
from carom.recording.edit.clip import clip
from carom.recording.layout import TRAILS, bodies_view
from carom.recording.layout.camera import CameraFit
from carom.recording.layout.canvas import LEGEND, Additions, Area, CameraMotion, Canvas, LensView, View, views_of
from carom.recording.read.frame_rows import RecordedRows
from carom.recording.read.named_events import NamedEvent, Pair, named_event, named_pair, pair_of_extreme
from carom.recording.read.recorded_scene import header_of_recording
from carom.recording.read.recording import Recording
from carom.recording.schema import paths
from carom.recording.write.rows import Rows
from carom.scene.load import Scene
from small_scenes import pair, scene_of


@pytest.fixture(scope="module")
def bounce(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    """Two spheres that meet between two frames."""
    scene = Scene.load("two-spheres", ["record.every=0.25"])
    return carom.run(scene, tmp_path_factory.mktemp("bounce") / "bounce.rrd")


def rows_of(path: str, shown: list[Rows]) -> list[Rows]:
    return [rows for rows in shown if rows.path == path]


def values_of(path: str, component: str, shown: list[Rows]) -> list[Any]:
    """Return the values of a component of an entity, row by row."""
    columns = [column for rows in rows_of(path, shown) for column in rows.columns]
    own = [column for column in columns if str(column.component_descriptor()).split(":")[-1] == component]
    return [values for column in own for values in column.as_arrow_array().to_pylist()]


def test_a_moment_between_two_frames_shows_the_step_itself(bounce: Recording) -> None:
    step = request.shown_step(bounce, bounce.moment())
    assert step.step == bounce.closing["moments.impact.step"]
    assert step.step not in bounce.fingerprints()["step"].to_pylist()
    assert step.frame is not None and len(step.frame.contacts) == 1
    np.testing.assert_array_equal(step.position, step.frame.position - bounce.origin)


@pytest.mark.parametrize("every", ["step", 0.25])
def test_an_impact_at_the_beginning_of_a_step_is_shown_in_the_step_that_it_belongs_to(
    tmp_path: Path, every: Any
) -> None:
    bodies = [{"position": [0, 0, 0], "velocity": [1, 0, 0]}, {"position": [2, 0, 0]}]
    scene = scene_of(
        bodies, time={"duration": 1.0, "fixed_dt": 0.1}, record={"every": every}, contact={"timing": "time-of-impact"}
    )
    recording = carom.run(scene, tmp_path / "run.rrd")
    assert recording.impacts()["time"].to_pylist() == [0.0], "they touch from the start"
    shown = asked(recording, Request(event="impact:1"))
    assert shown.time == 0.0 and not shown.missing, "where they touch, not at the end of the step"
    assert values_of(NORMAL, "vectors", list(shown.supplement.rows)), "of the contact"


def test_a_window_onto_a_moment_has_every_step_up_to_the_next_frame(bounce: Recording) -> None:
    step = request.shown_step(bounce, bounce.moment(), dense=True)
    steps = [frame.step for frame in step.added]
    recorded = bounce.fingerprints()["step"].to_pylist()
    assert steps == list(range(steps[0], steps[-1] + 1))
    assert steps[0] - 1 in recorded and steps[-1] in recorded


def test_the_steps_that_are_run_again_are_shown_without_their_events(bounce: Recording) -> None:
    rows = list(presentation(bounce, bounce.moment()).supplement.rows)
    step = bounce.closing["moments.impact.step"]
    assert all(step in found.steps.tolist() for path in (paths.BODIES, paths.CONTACTS) for found in rows_of(path, rows))
    assert rows_of(paths.BODIES, rows) and not rows_of(paths.EVENTS, rows)


def test_the_phase_of_a_step_that_is_run_again_lasts_until_the_next_frame(bounce: Recording) -> None:
    shown = presentation(bounce, bounce.moment())
    rows = list(shown.supplement.rows)
    states = dict(zip(bounce.phases()["step"].to_pylist(), bounce.phases()["state"].to_pylist(), strict=True))
    recorded = bounce.fingerprints()["step"].to_numpy()
    following = int(recorded[recorded > bounce.closing["moments.impact.step"]][0])
    as_recorded = [state for step, state in states.items() if step <= following][-1]
    steps = [step for found in rows_of(paths.PHASE, rows) for step in found.steps.tolist()]
    shown_states = dict(zip(steps, values_of(paths.PHASE, "state", rows), strict=True))
    assert shown_states[bounce.closing["moments.impact.step"]] == ["colliding"]
    assert shown_states[following] == [as_recorded] == ["free"]
    assert following in [step for found in rows_of(paths.DT_LIMIT, rows) for step in found.steps.tolist()]


def test_steps_that_are_run_again_leave_the_magnitudes_of_arrows_as_they_were_given(bounce: Recording) -> None:
    given, header = dict[str, float](), header_of_recording(bounce)
    rows, known = _steps(bounce, header, request.shown_step(bounce, bounce.moment(None)), given)
    assert rows and known and not given, "as in a file whose frames have no arrow"


def test_a_step_that_cannot_be_run_again_is_replaced_by_the_frame_before_it_with_the_reason(
    bounce: Recording, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("carom.state.frame.fingerprint_of", lambda time, arrays: 1)
    shown = presentation(bounce, bounce.moment())
    assert "its bits differ" in shown.missing
    assert shown.time == pytest.approx(1.5, abs=1e-12), "the frame before 1.605 s"


def test_a_step_that_a_clip_of_some_bodies_does_not_have_is_replaced_with_the_reason(
    bounce: Recording, tmp_path: Path
) -> None:
    clip(bounce.path, tmp_path / "clip.rrd", 1.0, 2.0, bodies=[1])
    step = request.shown_step(Recording.open(tmp_path / "clip.rrd"), bounce.moment())
    assert step.time == pytest.approx(1.5, abs=1e-12)
    assert step.missing == "the clip shows only some of the bodies"


@pytest.mark.slow
def test_a_floor_is_drawn_under_the_bodies_that_are_shown(tmp_path: Path) -> None:
    ball = {"position": [0, 0, 0.1], "velocity": [5, 0, 0], "radius": 0.1}
    scene = scene_of(
        [ball], plane=[{}], gravity={"constant": 0.0, "uniform": [0, 0, -9.81]}, time={"duration": 2.0, "max_dt": 0.1}
    )
    recording = carom.run(scene, tmp_path / "run.rrd")
    planes = recording.drawn_planes()
    np.testing.assert_allclose(planes.normal * np.sign(planes.normal[0, 2]), [[0, 0, 1]], atol=1e-6)  # float32
    np.testing.assert_allclose(planes.offset, 0.0, atol=1e-6)
    shown = presentation(recording, 2.0)
    grid = dict(shown.supplement.statics)[paths.PLANES]
    lines = cast(Any, grid).strips.as_arrow_array().flatten().flatten().to_numpy().reshape(-1, 3)
    place = request.shown_step(recording, 2.0).position[0]
    assert place[0] > 5.0, "far from where it began"
    np.testing.assert_allclose(lines[:, 2], -recording.origin[2], atol=1e-5)  # float32
    first = np.array(ball["position"]) - recording.origin
    for where in (first, place):
        assert np.all(lines.min(axis=0)[:2] <= where[:2]) and np.all(where[:2] <= lines.max(axis=0)[:2])


def test_the_close_up_shows_normal_impulse_and_spins_of_the_hardest_impact(bounce: Recording) -> None:
    shown = presentation(bounce, bounce.moment())
    step = bounce.closing["moments.impact.step"]
    for path in (close_up.EDGE, NORMAL, IMPULSE, SPIN, close_up.LABELS):
        rows = rows_of(path, list(shown.supplement.rows))
        times = np.concatenate([own.index.times for own in rows])
        steps = np.concatenate([own.steps for own in rows])
        assert len(times) == 2 and times[0] <= shown.time and step in steps, "they vanish at the next frame"


@pytest.fixture(scope="module")
def glancing(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    """Two balls that meet off centre within a long step, and are 0.8 radii apart at its end; a third ball is hit next.

    The first ball begins at x = -0.31 m with 1 m/s; centres are one radius apart across, so they meet at x = -√3 r.
    """
    r = 0.0285
    balls = [
        {"position": [-0.31, 0.0, 0.0], "velocity": [1.0, 0.0, 0.0]},
        {"position": [0.0, r, 0.0]},
        {"position": [0.4, 0.4, 0.0]},
    ]
    scene = scene_of(
        [ball | {"radius": r, "mass": 0.17} for ball in balls],
        gravity={"constant": 0.0},
        contact={"timing": "time-of-impact", "restitution": 0.9},
        time={"duration": 0.9, "fixed_dt": 0.3},
        record={"every": "step"},
    )
    return carom.run(scene, tmp_path_factory.mktemp("glancing") / "glancing.rrd")


def within_a_step(path: str, shown: list[Rows]) -> list[Rows]:
    return [rows for rows in rows_of(path, shown) if not len(rows.steps) and len(rows.index.times)]


@pytest.mark.parametrize("request_", [Request(event="impact:1"), Request(event="impact"), Request()])
def test_the_close_up_of_an_impact_shows_the_instant_at_which_the_balls_touch(
    request_: Request, glancing: Recording
) -> None:
    r, (impact,) = 0.0285, glancing.impacts().to_pylist()
    shown = asked(glancing, request_)
    moment = 0.31 - np.sqrt(3.0) * r
    assert shown.time == pytest.approx(moment, abs=1e-12)
    rows = list(shown.supplement.rows)
    for path in (
        close_up.BODIES,
        close_up.EDGE,
        NORMAL,
        IMPULSE,
        paths.BODIES,
        paths.CONTACTS,
    ):
        (own,) = within_a_step(path, rows)
        assert own.index.times[0] == shown.time, path
    here = within_a_step(close_up.BODIES, rows)
    left, right = np.array(values_of(close_up.BODIES, "centers", here)[0])
    assert np.linalg.norm(right - left) == pytest.approx(2.0 * r, rel=1e-6), "they touch; single precision"
    normal = np.array(values_of(NORMAL, "vectors", within_a_step(NORMAL, rows))[0][0])
    along = normal / np.linalg.norm(normal)
    np.testing.assert_allclose(along, (right - left) / (2.0 * r), atol=1e-6)
    np.testing.assert_allclose(along, [np.sqrt(0.75), 0.5, 0.0], atol=1e-6)
    all_bodies = np.array(values_of(paths.BODIES, "centers", within_a_step(paths.BODIES, rows))[0])
    np.testing.assert_allclose(all_bodies[:2], [left, right], atol=1e-8)
    energy = 0.5 * 0.17 * 1.0**2
    (before,), (after,) = values_of("energy/total", "scalars", within_a_step("energy/total", rows))
    assert [before, after] == pytest.approx([energy, energy - impact["energy_lost"]], rel=1e-6), "the plot steps there"


def test_the_close_up_of_an_impact_states_spins_and_angular_impulses_by_name(glancing: Recording) -> None:
    """The arm of the friction is the radius; both balls are alike, and so are their changes of spin."""
    (impact,) = glancing.impacts().to_pylist()
    rows = within_a_step(close_up.LABELS, list(asked(glancing, Request(event="impact:1")).supplement.rows))
    texts = values_of(close_up.LABELS, "labels", rows)[0]
    angular = 0.0285 * impact["tangential_impulse"]
    spin = angular / (0.4 * 0.17 * 0.0285**2)
    for name in ("body 0", "body 1"):
        assert f"{name}: spin 0 before, {spin:.3g} rad/s after" in texts
        assert f"{name}: angular impulse {angular:.3g} N m s" in texts
    # equal masses share the velocity along the normal by (1 ± e)/2, and friction along the tangent
    normal, push = np.array([np.sqrt(0.75), 0.5, 0.0]), impact["tangential_impulse"] / 0.17
    tangent = np.array([0.5, -np.sqrt(0.75), 0.0])
    after = 0.95 * np.sqrt(0.75) * normal + push * tangent
    speeds = {"body 0": (1.0, np.linalg.norm([1.0, 0.0, 0.0] - after)), "body 1": (0.0, np.linalg.norm(after))}
    lines = " ".join(legend_texts(asked(glancing, Request(event="impact:1"))))
    for name, (first, last) in speeds.items():
        assert f"■ {name} close up: speed {first:.3g} before, {last:.3g} m/s after" in lines
    whole = np.hypot(impact["normal_impulse"], impact["tangential_impulse"])
    assert f"{whole:.3g} N s, friction included" in texts, (
        "the arrow is the sum of both, unlike the normal one in tables"
    )


def test_the_close_up_of_an_impact_has_arrows_of_the_velocities_before_and_after(glancing: Recording) -> None:
    shown = asked(glancing, Request(event="impact:1"))
    rows = list(shown.supplement.rows)
    (before,), (one, other) = (
        np.array(values_of(path, "vectors", within_a_step(path, rows))[0]) for path in (BEFORE, VELOCITY)
    )
    assert before[0] > 0.0 and abs(before[1]) + abs(before[2]) < 1e-7 * before[0], "only the first ball moves, along x"
    np.testing.assert_allclose(one + other, before, atol=1e-6 * before[0])  # equal masses share the momentum
    texts = " ".join(legend_texts(shown))
    assert "→ velocity before, close up" in texts and "→ velocity after, close up: 1.3 radii = 1 m/s" in texts


def test_an_impact_at_the_end_of_a_step_has_speeds_before_and_after_too(tmp_path: Path) -> None:
    """Balls of equal mass exchange their velocities; the gap of the cradle is a whole number of steps."""
    cradle = carom.run(Scene.load("newtons-cradle", ["time.duration=0.75"]), tmp_path / "cradle.rrd")
    lines = " ".join(legend_texts(asked(cradle, Request(event="impact:1"))))
    for name, first, last in (("striker 2", 1, 0), ("ball 1", 0, 1)):
        assert f"■ {name} close up: speed {first} before, {last} m/s after" in lines


@pytest.mark.parametrize("normal", [[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.6, -0.8, 0.0]])
def test_a_close_up_is_seen_from_where_no_arrow_points_at_the_eye(normal: list[float]) -> None:
    across = np.array(normal)
    usual = close_up_camera.direction(np.zeros((1, 3)), across, np.zeros((0, 3)))
    assert usual is not None
    to_eye = close_up_camera.direction(np.zeros((1, 3)), across, usual[None])
    assert to_eye is not None and abs(to_eye @ usual) < np.sqrt(1.0 - close_up_camera.SEEN**2), (
        "at least half of it is seen"
    )


def legend_texts(shown: Presentation) -> list[str]:
    legend: Any = dict(shown.supplement.statics)[LEGEND]
    return [" ".join(text.strip("\xa0\xad").split()) for text in legend.labels.as_arrow_array().to_pylist()]


def test_a_picture_of_a_close_up_has_its_numbers_in_the_legend_and_no_label_on_its_arrows(glancing: Recording) -> None:
    shown = asked(glancing, Request(event="impact:1"), Canvas(800, 500, framed=False, rendered=True), "close-up")
    assert not rows_of(close_up.LABELS, list(shown.supplement.rows))
    lines = legend_texts(shown)
    text = " ".join(lines)
    assert lines.index("■ body 0") < lines.index("■ body 1") and text.count("speed") == 2
    assert text.count("angular impulse") == 2 and text.count("spin 0 before") == 2 and "→ spin" in text
    assert "→ normal, " in text and "→ impulse on each body, " in text


def test_arrows_of_impulses_point_out_of_planes(tmp_path: Path) -> None:
    """The floor pushes the ball up and, since it slides along x, friction pushes it back."""
    ball = {"position": [0.0, 0.0, 0.5], "velocity": [3.0, 0.0, 0.0], "radius": 0.5}
    scene = scene_of(
        [ball],
        gravity={"constant": 0.0, "uniform": [0.0, 0.0, -10.0]},
        contact={"kinetic_friction": 0.3, "static_friction": 0.3},
        plane=[{"normal": [0.0, 0.0, 1.0]}],
        time={"duration": 0.02, "fixed_dt": 0.01},
        record={"every": "step"},
    )
    rows = RecordedRows(carom.run(scene, tmp_path / "slide.rrd"))
    normal, friction = (
        rows.at(path, 2)[0].batch["Arrows3D:vectors"][0].values.to_pylist()[0]
        for path in (paths.FORCE_NORMAL, paths.FORCE_FRICTION)
    )
    assert normal[2] > 0.0 and friction[0] < 0.0


def test_the_close_up_of_a_lasting_contact_states_no_approach_speed(tmp_path: Path) -> None:
    """What a force adds to the speed within a step is no motion: the ball rolls, 5/7 g sin 30° fast."""
    recording = carom.run(Scene.load("incline", ["time.duration=0.1"]), tmp_path / "slope.rrd")
    rows = list(asked(recording, Request(at=0.1, bodies="rolling"), only="close-up").supplement.rows)
    texts = values_of(close_up.LABELS, "labels", rows)[0]
    normal, friction = 9.81 * np.sqrt(0.75), 2.0 / 7.0 * 9.81 * 0.5
    assert texts[0] == "normal"
    assert texts[1].startswith(f"{np.hypot(normal, friction):.3g} N, friction included, ")


def test_bodies_that_never_touch_have_no_view_and_no_legend_of_contacts(tmp_path: Path) -> None:
    recording = carom.run(pair(-1.0), tmp_path / "apart.rrd")
    shown = asked(recording, Request(at=0.0)).supplement
    names = [str(view.name) for view in views_of(shown.layout.root_container)]
    assert (names[0], names[-1]) == ("Bodies", "Legend") and not any("contacts" in name for name in names)
    legend: Any = dict(shown.statics)[LEGEND]
    lines = [text.strip("\xa0\xad") for text in legend.labels.as_arrow_array().to_pylist()]
    assert lines == ["■ body 0", "■ body 1", "— path so far"]
    with pytest.raises(RecordingError, match="there is no collision graph"):
        asked(recording, Request(at=0.0), only="graph")


def test_a_time_that_is_asked_for_is_shown_and_the_impact_before_it_stays_where_it_was(glancing: Recording) -> None:
    shown = asked(glancing, Request(at=0.3))
    assert shown.time == pytest.approx(0.3, abs=1e-12)
    rows = list(shown.supplement.rows)
    assert not within_a_step(paths.BODIES, rows) and len(within_a_step(NORMAL, rows)) == 1
    assert asked(glancing, Request(at=0.3), only="close-up").time < 0.27, "a close-up alone is of the impact"


@pytest.mark.parametrize("narrow", [True, False])
@pytest.mark.parametrize("area", [Area(360.0, 480.0), Area(800.0, 500.0)])
def test_no_label_of_the_close_up_covers_another_or_leaves_the_view(area: Area, narrow: bool) -> None:
    texts = ["normal, 5 m/s", "92 N s", "spin 0 rad/s before, 3 rad/s after", "spin 0 rad/s before, 4 rad/s after"]
    random = np.random.default_rng(1)
    for _ in range(20):
        bodies = random.uniform(-1.0, 1.0, (2, 3))
        eye = CameraFit(np.full(2, 0.5), bodies).view(area.aspect, narrow=narrow)
        placed = letters.apart(random.uniform(-1.5, 1.5, (4, 3)), texts, eye, area)
        points = eye.on_screen(placed) * area.height / 2
        wide = np.array([letters.label_width(text) for text in texts])
        tall = letters._HEIGHT
        assert np.all(np.abs(points[:, 0]) + wide / 2 <= area.width / 2 + 1e-6)
        assert np.all(points[:, 1] <= area.height / 2 + 1e-6) and np.all(
            points[:, 1] - letters._BELOW >= -area.height / 2 - 1e-6
        )
        across, up = np.abs(points[:, None] - points).transpose(2, 0, 1)
        covers = (across < (wide[:, None] + wide) / 2 - 1e-6) & (up < tall - 1e-6) & ~np.eye(4, dtype=bool)
        assert not covers.any()


def test_a_label_that_is_free_and_inside_stays_where_it_is() -> None:
    eye = View(np.zeros(3), 10.0, CameraMotion.STILL, np.array([0.0, -1.0, 0.0]))
    near = np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.1], [3.0, 0.0, 0.0]])
    placed = letters.apart(near, ["normal, 5 m/s", "92 N s", "4 rad/s"], eye, Area(800.0, 500.0))
    np.testing.assert_allclose(placed[[0, 2]], near[[0, 2]], atol=1e-12)


def test_both_balls_of_a_close_up_look_equal_and_the_arrows_of_impulses_end_inside(bounce: Recording) -> None:
    canvas = Canvas(800, 500, framed=False, rendered=True)
    shown = asked(bounce, Request(), canvas, "close-up")
    (lens,) = (each.lens for each in views_of(shown.supplement.layout.root_container) if isinstance(each, LensView))
    rows = list(shown.supplement.rows)
    balls = np.array(values_of(close_up.BODIES, "centers", within_a_step(close_up.BODIES, rows))[0])
    apparent = lens.view.radius_on_screen(balls, header_of_recording(bounce).radius)
    assert apparent.max() <= 1.05 * apparent.min() and lens.view.holds(balls, np.zeros(2), 1.6).all()
    drawn = within_a_step(IMPULSE, rows)
    vectors, origins = (np.array(values_of(IMPULSE, name, drawn)[0]) for name in ("vectors", "origins"))
    assert np.all(np.abs(lens.view.on_screen(origins + vectors)) <= [1.6, 1.0])


def test_arrows_of_impulses_end_inside_the_view_of_the_graph(bounce: Recording) -> None:
    for canvas in (Canvas(rendered=True), Canvas(800, 500, framed=False, rendered=True)):
        shown = asked(bounce, Request(), canvas, "graph")
        (lens,) = (each.lens for each in views_of(shown.supplement.layout.root_container) if isinstance(each, LensView))
        for path in (*paths.OF_IMPACTS, paths.FORCE_NORMAL, paths.FORCE_FRICTION):
            drawn = within_a_step(path, list(shown.supplement.rows))
            vectors, origins = (np.array(values_of(path, name, drawn)[0]) for name in ("vectors", "origins"))
            assert len(vectors) > 0
            assert np.all(np.abs(lens.view.on_screen(origins + vectors)) <= [canvas.area().aspect, 1.0]), path


def test_the_close_up_follows_its_bodies_through_all_frames(bounce: Recording) -> None:
    rows = rows_of(close_up.BODIES, list(presentation(bounce, bounce.moment()).supplement.rows))
    assert {step for found in rows for step in found.steps.tolist()} >= set(bounce.fingerprints()["step"].to_pylist())


def test_the_close_up_shows_two_bodies_that_meet_through_a_periodic_border_side_by_side(tmp_path: Path) -> None:
    left = {"position": [-1.2, 0, 0], "velocity": [-1, 0.1, 0], "radius": 0.3}
    right = {"position": [1.2, 0.2, 0], "velocity": [0.5, 0, 0], "radius": 0.3}
    box = {"boundary": "periodic", "size": [4, 4, 4]}
    scene = scene_of([left, right], gravity={"constant": 0}, domain=box, time={"duration": 1, "max_dt": 0.01})
    recording = carom.run(scene, tmp_path / "run.rrd")
    rows = list(presentation(recording, recording.moment()).supplement.rows)
    for bodies in values_of(close_up.BODIES, "centers", rows):
        assert np.abs(np.subtract(*bodies)).max() <= 2.0, "half the box"
    edge = values_of(close_up.EDGE, "strips", rows)[0][0]
    assert np.linalg.norm(np.subtract(*edge)) == pytest.approx(0.6, abs=0.01), "two radii"
    normal, impulse = (values_of(path, "origins", rows)[0][0] for path in (NORMAL, IMPULSE))
    assert np.linalg.norm(np.subtract(normal, impulse)) == pytest.approx(0.3, abs=0.01), "on the first body"


@pytest.mark.parametrize("met", [False, True])
def test_a_view_of_bodies_that_may_meet_but_do_not_includes_their_whole_paths(
    met: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    included: list[CameraFit] = []

    def show_all(self: CameraFit) -> None:
        included.append(self)

    monkeypatch.setattr(CameraFit, "show_all", show_all)
    scene = pair(offset=0.0 if met else 3.0, time={"duration": 2.0, "fixed_dt": 0.1})
    presentation(carom.run(scene, tmp_path / "run.rrd"), 2.0)
    assert len(included) == (0 if met else 1)


def test_a_pair_is_found_by_numbers_names_and_events(bounce: Recording) -> None:
    assert (
        named_pair(bounce, "right, left")
        == named_pair(bounce, "0,1")
        == pair_of_extreme(bounce, "impact")
        == Pair(0, 1)
    )
    for name in ("impact", "overlap"):
        time = bounce.closing[f"moments.{name}.time"]
        assert named_event(bounce, name) == NamedEvent(time, Pair(0, 1), is_impact=name == "impact")
    first = named_event(bounce, "first-contact")
    assert first.time == pytest.approx(bounce.moment(), abs=1e-8) and first.pair == Pair(0, 1)


def test_a_pair_is_found_by_names_with_commas(tmp_path: Path) -> None:
    bodies = [{"name": name, "position": [3 * k, 0, 0]} for k, name in enumerate(("Ceres, dwarf", "Vesta, 4", "Vesta"))]
    recording = carom.run(scene_of(bodies, time={"duration": 0.1}), tmp_path / "run.rrd")
    assert named_pair(recording, "Ceres, dwarf,Vesta, 4") == Pair(0, 1)
    assert named_pair(recording, "Vesta,Ceres, dwarf") == Pair(0, 2)
    with pytest.raises(RecordingError, match="expected two bodies separated by a comma"):
        named_pair(recording, "Ceres, dwarf")


def test_an_impact_is_found_by_its_number_on_the_timeline(bounce: Recording) -> None:
    impacts = bounce.impacts()
    for row in (0, len(impacts) - 1):
        found = named_event(bounce, f"impact:{row + 1}")
        assert (found.time, found.step) == (impacts["time"][row].as_py(), impacts["step"][row].as_py())
        assert found.pair == Pair(impacts["i"][row].as_py(), impacts["j"][row].as_py())
    with pytest.raises(RecordingError, match="has not recorded impact 99; its only impact is 1"):
        named_event(bounce, "impact:99")
    with pytest.raises(RecordingError, match=r"^event impact:last: expected the number of an impact"):
        named_event(bounce, "impact:last")


def test_the_pair_of_a_step_is_that_of_the_largest_impulse(bounce: Recording) -> None:
    frame = request.shown_step(bounce, bounce.moment()).frame
    assert frame is not None
    rows = np.zeros(2, CONTACT_ROW)
    rows["i"], rows["j"], rows["normal_impulse"] = [0, 1], [1, 2], [1.0, 3.0]
    graph = replace(
        frame.contacts,
        pairs=np.array([[0, 1], [1, 2]]),
        normals=np.zeros((2, 3)),
        overlaps=np.zeros(2),
        colours=np.zeros(2, dtype=np.int64),
    )
    assert pair_of_step(replace(frame, contacts=graph, contact_rows=rows), bodies=2) == Pair(1, None, plane=0)
    rows["friction_x"][0] = 4.0
    assert pair_of_step(replace(frame, contacts=graph, contact_rows=rows), bodies=2) == Pair(0, 1), "with friction"


@pytest.mark.parametrize(
    ("at", "name", "bodies", "said"),
    [
        (99.0, None, None, "covers 0 to 4 s; 99 s is outside"),
        (None, "bang", None, 'has no event "bang"; there are'),
        (None, None, "0,7", 'has no body "7"'),
        (None, None, "left", "expected two bodies separated by a comma, such as 0,1"),
        (None, None, "0,left", "is one body; name two"),
    ],
)
def test_a_request_for_a_missing_moment_or_body_is_refused_in_one_sentence(
    at: float | None, name: str | None, bodies: str | None, said: str, bounce: Recording
) -> None:
    with pytest.raises(RecordingError, match=said):
        asked(bounce, Request(at, name, bodies))


def test_a_scene_without_contacts_has_no_close_up_and_no_graph(tmp_path: Path) -> None:
    scene = Scene.load("figure-eight", ["time.duration=0.1"])
    recording = carom.run(scene, tmp_path / "eight.rrd")
    for view, said in (("close-up", "name two bodies"), ("graph", "no collision graph")):
        with pytest.raises(RecordingError, match=said):
            presentation(recording, 0.0, only=view)


def strips_of(recording: Recording) -> list[Any]:
    """Return the pieces of all trails, frame by frame, in each frame body by body."""
    rows = list(Trails(recording, header_of_recording(recording), np.zeros(len(recording.shown), np.uint32)).rows())
    return [strip for frame in values_of(TRAILS, "strips", rows) for strip in frame]


def test_an_orbit_of_few_frames_has_a_round_trail(tmp_path: Path) -> None:
    sun = {"radius": 0.01, "mass": 1.0, "fixed": True}
    planet = {"radius": 0.01, "mass": 1e-9, "position": [1.0, 0.0, 0.0], "velocity": [0.0, 1.0, 0.0]}
    time = {"duration": 12.0, "integrator": "gauss-radau15"}
    scene = scene_of([sun, planet], time=time, gravity={"constant": 1.0})
    recording = carom.run(scene, tmp_path / "orbit.rrd")
    assert recording.frames < 100
    pieces = strips_of(recording)
    around = np.concatenate(pieces[1::2]) - pieces[0][0]
    distances = np.sqrt((around**2).sum(axis=1))
    assert len(around) >= 1000
    # a cubic spline errs by 5/384 (h ω)⁴ between its knots, here h < 0.5, and by more in the first and the last piece
    assert np.abs(distances - 1.0).max() < 5e-3


def test_a_trail_leads_to_a_body_in_a_step_without_a_frame(tmp_path: Path) -> None:
    """A comet that passes its perihelion, 0.005 of its aphelion, between two frames."""
    sun = {"radius": 1e-4, "mass": 1.0, "fixed": True}
    comet = {"radius": 1e-4, "mass": 1e-9, "position": [1.0, 0.0, 0.0], "velocity": [0.0, 0.1, 0.0]}
    time = {"duration": 4.0, "integrator": "gauss-radau15"}
    scene = scene_of([sun, comet], time=time, gravity={"constant": 1.0}, record={"every": 1.0})
    recording = carom.run(scene, tmp_path / "comet.rrd")
    shown = asked(recording, Request(at=1.115))  # half a period is 1.119
    assert shown.time not in recording.fingerprints()["time"].to_pylist()
    (bodies,) = (rows for rows in shown.supplement.rows if rows.path == paths.BODIES and shown.time in rows.index.times)
    place = values_of(paths.BODIES, "centers", [bodies])[bodies.index.times.tolist().index(shown.time)][1]
    assert np.linalg.norm(place) < 0.1, "near the sun"
    (trails,) = rows_of(TRAILS, list(shown.supplement.rows))
    piece = values_of(TRAILS, "strips", [trails])[trails.index.times.tolist().index(shown.time)][1]
    np.testing.assert_allclose(piece[-1], place, atol=1e-6)


def test_the_trail_of_a_body_that_bounced_is_straight_from_frame_to_frame(bounce: Recording) -> None:
    assert {len(piece) for piece in strips_of(bounce)} == {2}


def test_paths_that_would_be_a_tangle_are_drawn_for_a_short_time_which_the_legend_states(tmp_path: Path) -> None:
    """Two balls in a lane: they cross it 40 times in one run, and once in the other."""
    found = list[tuple[list[str], Any]]()
    for speed in (1.0, 40.0):
        lane = {"boundary": ["walls", "walls", "walls"], "size": [1.0, 1.0, 1.0]}
        balls = [{"radius": 0.05, "position": [0.0, y, 0.0], "velocity": [speed, 0.0, 0.0]} for y in (-0.2, 0.2)]
        elastic = {"restitution": 1.0, "static_friction": 0.0, "kinetic_friction": 0.0}
        settings = {"time": {"duration": 1.0}, "gravity": {"constant": 0.0}, "contact": elastic}
        scene = scene_of(balls, **settings, domain=lane, record={"every": 0.005})
        shown = asked(carom.run(scene, tmp_path / f"{speed}.rrd"), Request(at=0.5)).supplement
        labels: Any = dict(shown.statics)[LEGEND]
        lines = [text.strip("\xa0\xad") for text in labels.labels.as_arrow_array().to_pylist()]
        bodies = next(view for view in views_of(shown.layout.root_container) if view.name == "Bodies and contacts")
        drawn: Any = bodies.visualizer_overrides[TRAILS]
        found.append(([line for line in lines if "path" in line], drawn))
    (whole, all_of_it), (cut, short) = found
    assert whole == ["— path so far"] and cut == ["— path of the last 0.2 s"], "20 × 0.9 m at twice 40 m/s"
    assert all_of_it != short
    start = short.ranges.as_arrow_array().to_pylist()[0]["range"]["start"]
    assert start == -200_000_000, "ns"


def test_numbers_beside_arrows_neither_cover_each_other_nor_leave_the_view(bounce: Recording) -> None:
    canvas = Canvas(500, 400, framed=False, rendered=True)
    shown = asked(bounce, Request(), canvas, "graph")
    (lens,) = (each.lens for each in views_of(shown.supplement.layout.root_container) if isinstance(each, LensView))
    rows = within_a_step(paths.ANGULAR_IMPULSE, list(shown.supplement.rows))
    texts = values_of(paths.ANGULAR_IMPULSE, paths.NUMBERS, rows)[0]
    places = np.array(values_of(paths.ANGULAR_IMPULSE, paths.NUMBERS_AT, rows)[-1])  # the last row is shown
    points = lens.view.on_screen(places) * canvas.height / 2
    wide = np.array([letters.label_width(text) for text in texts])
    assert len(texts) == 2 and np.all(np.abs(points[:, 0]) + wide / 2 <= canvas.width / 2 + 1.0)
    across, up = np.abs(points[0] - points[1])
    assert across >= wide.sum() / 2 - 1.0 or up >= letters._HEIGHT - 1.0


def test_a_spin_that_ends_in_an_impact_sets_no_scale(tmp_path: Path) -> None:
    """The angular momentum about the point of contact, m v r + 2/5 m r² ω, is zero, and friction is large."""
    ball = {"position": [0, 0, 0.15], "velocity": [-0.4, 0, -1], "angular_velocity": [0, 10, 0], "radius": 0.1}
    contact = {"restitution": 0.5, "static_friction": 5.0, "kinetic_friction": 5.0}
    settings: dict[str, Any] = {"time": {"duration": 0.1}, "gravity": {"constant": 0.0}}
    recording = carom.run(scene_of([ball], plane=[{}], contact=contact, **settings), tmp_path / "run.rrd")
    lines = legend_texts(asked(recording, Request(event="impact:1")))
    assert any("close up: speed" in line for line in lines) and not any("→ spin" in line for line in lines)


def test_angular_impulses_beside_spins_are_those_of_all_impacts_of_a_body_at_that_instant(tmp_path: Path) -> None:
    recording = carom.run(Scene.load("billiards", ["time.duration=0.2"]), tmp_path / "run.rrd")
    rows = within_a_step(close_up.LABELS, list(asked(recording, Request()).supplement.rows))
    found = [text.removeprefix("object ball: ") for text in values_of(close_up.LABELS, "labels", rows)[0]]
    (spin,) = (float(text.split()[3]) for text in found if text.startswith("spin 0 before"))
    angular = next(float(text.split()[2]) for text in found if text.startswith("angular impulse"))
    inertia = float(header_of_recording(recording).inertia[1])
    assert angular == pytest.approx(inertia * spin, rel=5e-3), "it touches the cloth, too; both have three digits"


def test_trails_that_are_cut_are_cut_on_the_timeline_of_steps_as_well(bounce: Recording) -> None:
    header = header_of_recording(bounce)
    camera = CameraFit(header.radius, np.zeros((2, 3)))
    view = bodies_view(header, camera, Area(800.0, 500.0), Additions(trails=True, recent=(10**9, 40)))
    ranges: Any = view.visualizer_overrides[TRAILS]
    starts = [each["start"] for each in ranges.ranges.as_arrow_array().field("range").to_pylist()]
    assert starts == [-(10**9), -40]
    trails = Trails(bounce, header, np.zeros(2, np.uint32))
    steps, times = (bounce.fingerprints()[name].to_numpy() for name in ("step", "time"))
    assert trails.steps_of(times[-1] - times[0]) == steps[-1] - steps[0] and trails.steps_of(0.0) == 1


def test_of_two_impacts_of_a_pair_in_a_step_the_hardest_is_shown(tmp_path: Path) -> None:
    """Ball 1 hits ball 2 and is hit from behind by the heavy striker, which makes it hit ball 2 again, more slowly."""
    balls: list[dict[str, Any]] = [{"position": [0.1003 * k, 0, 0], "radius": 0.05, "mass": 4.0} for k in range(4)]
    striker = {"position": [-0.5, 0, 0], "velocity": [1.2, 0, 0], "radius": 0.063, "mass": 8.0}
    settings: dict[str, Any] = {"time": {"duration": 0.4, "max_dt": 0.01}, "gravity": {"constant": 0.0}}
    contact = {"restitution": 0.9, "static_friction": 0.0, "kinetic_friction": 0.0}
    recording = carom.run(scene_of([striker, *balls], contact=contact, **settings), tmp_path / "run.rrd")
    own = [row for row in recording.impacts().to_pylist() if (row["i"], row["j"]) == (1, 2)]
    step = recording.closing["moments.impact.step"]
    fastest = max(own, key=lambda row: row["approach_speed"])
    assert len([row for row in own if row["step"] == step]) > 1 and fastest["step"] == step
    assert asked(recording, Request()).time == pytest.approx(fastest["time"], abs=1e-9)
