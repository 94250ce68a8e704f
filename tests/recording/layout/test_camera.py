import warnings
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.typing import NDArray

from carom.recording.layout import camera
from carom.recording.layout.camera import CameraFit
from carom.recording.layout.canvas import CameraMotion, View, corners_of, turned
from carom.recording.schema.header import Header
from carom.scene.start import HalfSpaces
from scripted_run import ScriptedRun

FloatArray = NDArray[np.float64]
SLOPE = np.tan(np.radians(55 / 2))  # Rerun's eye opens 55° from top to bottom


def on_screen(view: View, position: FloatArray, aspect: float) -> FloatArray:
    """Return places in the picture, (n, 2): its shorter side goes from -1 to 1."""
    right = np.cross([0.0, 0.0, 1.0], view.to_eye)
    right /= np.linalg.norm(right)
    axes = np.stack([right, np.cross(view.to_eye, right)])
    offset = position - view.eye
    places: FloatArray = (offset @ axes.T) / (-offset @ view.to_eye)[:, None] / SLOPE
    return places / min(1.0, aspect)


def filled(view: View, position: FloatArray, aspect: float) -> float:
    """Return the share of the shorter side that the bodies reach across, the larger of both directions."""
    return float(np.ptp(on_screen(view, position, aspect), axis=0).max() / 2)


@pytest.mark.parametrize("aspect", [0.6, 1.0, 1.9])
@pytest.mark.parametrize("stretched", [(1, 1, 1), (1, 0.05, 0.05), (1, 1, 0.01), (0.02, 0.02, 1)])
def test_bodies_of_any_shape_fill_half_of_the_shorter_side_and_stay_inside(
    aspect: float, stretched: tuple[float, float, float]
) -> None:
    position = np.random.default_rng(1).normal(size=(19, 3)) * stretched * 100 + 1e4
    view = CameraFit(np.full(19, 0.1), position).view(aspect)
    assert filled(view, position, aspect) > 0.5
    places = np.abs(on_screen(view, position, aspect)) * min(1.0, aspect)
    assert np.all(places <= [aspect, 1.0])


@pytest.mark.parametrize("bodies", [4, 12])
def test_the_view_does_not_depend_on_the_batches_in_which_frames_arrive(bodies: int) -> None:
    random = np.random.default_rng(bodies)
    first = random.normal(size=(bodies, 3))
    motion = first + np.cumsum(random.normal(scale=0.03, size=(1500, bodies, 3)), axis=0)
    motion[7::50, 0] = np.nan  # a body that comes and goes
    whole, parts = (CameraFit(np.full(bodies, 0.1), first) for _ in range(2))
    whole.look(motion)
    for batch in np.array_split(motion, 37):
        parts.look(batch)
    # more spheres than are stored, of which the same remain; the sums that decide the direction differ by rounding
    assert np.allclose(whole.view().target, parts.view().target, rtol=1e-9, atol=0.0)
    assert whole.view().distance == pytest.approx(parts.view().distance, rel=1e-9)


def test_bodies_that_fly_off_do_not_shrink_the_rest(scripted: ScriptedRun) -> None:
    frames = list(scripted.frames(3))
    away = frames[2].position.copy()
    away[0] = [1e9, 0, 0]
    extent = CameraFit(scripted.header.radius, frames[0].position)
    extent.see([frames[1]], np.zeros(3))
    before = extent.view().distance
    extent.see([replace(frames[2], position=away)], np.zeros(3))
    assert extent.view().distance < 1.1 * before


@pytest.mark.parametrize("bodies", [8, 60])
def test_a_moment_is_framed_without_the_body_that_escapes(bodies: int) -> None:
    scripted = ScriptedRun(bodies)
    position = next(scripted.frames(1)).position
    whole = CameraFit(scripted.header.radius, position).view()
    position[0] = [1e6, 0, 0]
    assert CameraFit(scripted.header.radius, position).view().distance < 1.2 * whole.distance


def test_the_one_large_body_among_many_small_ones_is_seen_whole() -> None:
    position = np.random.default_rng(2).normal(size=(400, 3))
    radius = np.full(400, 0.01)
    position[0], radius[0] = [0.0, 0.0, 0.0], 20.0
    view = CameraFit(radius, position).view(1.0)
    assert view.height() > 2 * 20.0


def test_an_explosion_leaves_the_start_visible(scripted: ScriptedRun) -> None:
    frame = next(scripted.frames(1))
    extent = CameraFit(scripted.header.radius, frame.position)
    first = extent.view().distance
    extent.see([replace(frame, position=1000 * frame.position)], np.zeros(3))
    view = extent.view()
    assert first < view.distance
    assert filled(view, frame.position, 1.25) > 0.5


@pytest.mark.parametrize("aspect", [1.0, 3.3])
def test_an_orbit_is_seen_whole_where_all_bodies_are_near_its_pericentre(aspect: float) -> None:
    angle = np.linspace(0.0, 2 * np.pi, 200)
    e = 0.7
    orbit = np.stack([np.cos(angle) - e, np.sqrt(1 - e * e) * np.sin(angle), np.zeros(200)], axis=1)
    camera = CameraFit(np.full(2, 0.01), np.array([[0.0, 0.0, 0.0], orbit[0]]))
    camera.show_all()
    camera.look(np.stack([np.zeros_like(orbit), orbit], axis=1))
    places = np.abs(on_screen(camera.view(aspect), orbit, aspect)) * min(1.0, aspect)
    assert np.all(places <= [aspect, 1.0])


def test_walls_that_bodies_come_near_are_in_view_as_a_whole(scripted: ScriptedRun) -> None:
    header = replace(scripted.header, walls=np.array([50.0, 30.0, 90.0]))
    corners = corners_of(header, np.array([10.0, 0.0, 0.0]))
    assert corners is not None
    position = next(scripted.frames(1)).position
    for aspect in (0.7, 1.9):
        camera = CameraFit(header.radius, position, corners)
        camera.show_all()
        camera.look(0.9 * corners[np.arange(len(position)) % 8])
        view = camera.view(aspect)
        assert np.all(np.abs(on_screen(view, corners, aspect)) * min(1.0, aspect) <= [aspect, 1.0])


def test_bodies_that_leave_as_a_whole_are_followed(scripted: ScriptedRun) -> None:
    frame = next(scripted.frames(1))
    extent = CameraFit(scripted.header.radius, frame.position)
    first = extent.view()
    extent.see([replace(frame, position=frame.position + np.array([1e6, 0, 0]))], np.zeros(3))
    assert first.motion is CameraMotion.STILL
    assert extent.view().motion is CameraMotion.FOLLOW
    assert extent.view().distance < 1.1 * first.distance


def test_a_run_that_ended_in_nan_can_still_be_framed(scripted: ScriptedRun) -> None:
    frame = next(scripted.frames(1))
    nowhere = np.full_like(frame.position, np.nan)
    extent = CameraFit(scripted.header.radius, frame.position)
    extent.see([replace(frame, position=nowhere)], np.zeros(3))
    assert np.isfinite(extent.view().distance)
    assert np.isfinite(CameraFit(scripted.header.radius, nowhere).view().distance)


def test_a_part_of_very_many_bodies_frames_them_all(monkeypatch: pytest.MonkeyPatch) -> None:
    position = np.random.default_rng(5).normal(size=(20_000, 3))
    radius = np.full(20_000, 1e-3)
    monkeypatch.setattr(camera, "_NEARBY", 1.0)  # else only one of the two may show those that are a little outside
    position[7777], radius[7777] = [9.0, 0.0, 0.0], 1.0  # a planet that no equal sample would meet
    whole = CameraFit(radius, position).view()
    monkeypatch.setattr(camera, "_MOST", 1000)
    monkeypatch.setattr(camera, "_LARGEST", 10)
    part = CameraFit(radius, position).view()
    # the borders of a twentieth of the bodies are off by a few per cent of those of all
    assert part.distance == pytest.approx(whole.distance, rel=0.1)
    assert np.linalg.norm(part.target - whole.target) <= 0.1 * whole.distance
    assert np.all(np.abs(on_screen(part, position[[7777]], 1.25)) <= 1.0)


RADIUS = 0.1
places = st.floats(-5.0, 5.0)
motions = arrays(np.float64, st.tuples(st.integers(1, 6), st.integers(1, 5), st.just(3)), elements=places)


@given(motions, st.sampled_from([0.7, 1.0, 1.6]), st.sampled_from(CameraMotion))
def test_few_equal_spheres_look_equal_and_stay_in_a_rendered_picture(
    moments: FloatArray, aspect: float, motion: CameraMotion
) -> None:
    camera = CameraFit(np.full(moments.shape[1], RADIUS), moments[0], motion=motion)
    camera.look(moments)
    view = camera.view(aspect, narrow=True)
    for turn, moment in zip(np.linspace(0.0, 2 * np.pi, len(moments)), moments, strict=True):
        shown = view
        if motion is CameraMotion.FOLLOW:
            shown = replace(view, target=view.target + camera.offset(moment))
        elif motion is CameraMotion.ORBIT:
            shown = replace(view, to_eye=turned(view.to_eye, view.up, float(turn)))
        assert shown.holds(moment, np.full(len(moment), RADIUS), aspect).all()
        radii = shown.radius_on_screen(moment, np.full(len(moment), RADIUS))
        assert radii.max() <= 1.05 * radii.min(), "the issue asks for 5 %"


@given(motions)
def test_the_eye_is_above_the_ground_and_sees_gravity_point_down(moments: FloatArray) -> None:
    up = np.array([0.6, 0.0, 0.8])
    camera = CameraFit(np.full(moments.shape[1], RADIUS), moments[0], up=up)
    camera.look(moments)
    view = camera.view()
    assert np.sin(np.radians(14.9)) < view.to_eye @ up < np.sin(np.radians(60.1))
    fallen = view.on_screen(view.target - up)
    assert abs(fallen[0]) < 1e-9 and fallen[1] < 0.0, "a level horizon"


@pytest.mark.parametrize("thin", range(3))
def test_the_eye_looks_along_the_smallest_principal_axis_of_the_motion(thin: int) -> None:
    position = np.random.default_rng(3).normal(size=(30, 3))
    position[:, thin] *= 0.05
    to_eye = CameraFit(np.full(30, 0.1), position).view().to_eye
    least = np.sin(np.radians(60.0)) if thin == 2 else np.cos(np.radians(35.0))  # never from straight above
    assert abs(to_eye[thin]) >= least - 1e-9


def test_positions_whose_squares_overflow_have_a_camera_and_no_warning() -> None:
    fit = CameraFit(np.ones(2), np.zeros((2, 3)))
    with warnings.catch_warnings(action="error"):
        fit.look(np.array([[0.0, 0.0, 0.0], [1e300, 0.0, 0.0]]))
        assert np.linalg.norm(fit.view().to_eye) == pytest.approx(1.0)


def test_a_ball_that_falls_and_bounces_moves_in_a_picture_that_stands_still() -> None:
    height = np.abs(np.linspace(-1.0, 1.0, 41)) + RADIUS
    moments = np.zeros((41, 1, 3))
    moments[:, 0, 2] = height
    camera = CameraFit(np.array([RADIUS]), moments[20], motion=CameraMotion.STILL)
    camera.look(moments)
    view = camera.view(narrow=True)
    assert np.ptp(view.on_screen(moments[:, 0])[:, 1]) > 1.2, "the ball crosses more than half of the picture"


DOWNHILL, OUT, ACROSS = np.array([0.8, 0.0, -0.6]), np.array([0.6, 0.0, 0.8]), np.array([0.0, 1.0, 0.0])


def on_a_slope(scripted: ScriptedRun, *normals: FloatArray) -> Header:
    """A scene with planes through the origin, in a field along -z."""
    planes = HalfSpaces([""] * len(normals), np.array(normals), np.zeros(len(normals)))
    return replace(scripted.header, planes=planes, forces=frozenset({"uniform-field"}), scene_toml="")


def rolled(along: FloatArray, bodies: int) -> FloatArray:
    """Positions at 11 moments of bodies that begin side by side and roll over a slope, (11, n, 3) m."""
    begin = RADIUS * OUT + 3.0 * np.linspace(-1.0, 1.0, bodies)[:, None] * ACROSS
    paths: FloatArray = begin + np.linspace(0.0, 1.0, 11)[:, None, None] ** 2 * along
    return paths


def test_a_slope_is_seen_edge_on_with_gravity_down_and_the_motion_across_the_picture(scripted: ScriptedRun) -> None:
    slopes = on_a_slope(scripted, OUT), on_a_slope(scripted, OUT, np.array([0.0, 0.0, 1.0]))
    for header in (replace(each, has_torque=False) for each in slopes):
        moments = rolled(4.0 * DOWNHILL, header.bodies)
        camera = CameraFit.of_scene(header, np.zeros(3), moments[0])
        camera.look(moments)
        view = camera.view(narrow=True)
        assert abs(view.to_eye @ OUT) < 1e-12, "the slope is a line"
        assert view.axes()[1] == pytest.approx([0.0, 0.0, 1.0]), "gravity is down"
        assert np.ptp(view.on_screen(moments[:, 0])[:, 0]) > 1.0, "the path crosses more than half of the height"


def test_torques_of_balls_that_roll_down_a_slope_are_seen_from_aside(scripted: ScriptedRun) -> None:
    header = on_a_slope(scripted, OUT)
    assert header.has_torque
    moments = rolled(4.0 * DOWNHILL, header.bodies)
    camera = CameraFit.of_scene(header, np.zeros(3), moments[0])
    camera.look(moments)
    view = camera.view(narrow=True)
    torque = np.cross(OUT, DOWNHILL)
    assert 0.4 < np.linalg.norm(view.axes() @ torque) < 0.8, "an arrow keeps about half of its length"
    assert 0.1 < view.to_eye @ OUT < 0.7, "the slope is seen from above, not from below"
    assert view.on_screen(moments[-1])[:, 1].max() < view.on_screen(moments[0])[:, 1].min(), "bodies roll down"


@pytest.mark.parametrize(
    "scene",
    [
        '[gravity]\nuniform = ["3 m/s^2", 0, "-400 cm/s^2"]',
        'units = { length = "cm" }\n[gravity]\nuniform = [300, 0, "-4 m/s^2"]',
        'units = "dimensionless"\n[gravity]\nuniform = [3, 0, -4]',
    ],
)
def test_up_is_against_a_field_whatever_the_units_of_its_components(scripted: ScriptedRun, scene: str) -> None:
    header = replace(on_a_slope(scripted, OUT), scene_toml=scene)
    camera = CameraFit.of_scene(header, np.zeros(3), np.zeros((header.bodies, 3)))
    assert camera.up == pytest.approx([-0.6, 0.0, 0.8])


def test_a_slope_over_which_bodies_move_sideways_or_a_funnel_is_seen_from_above(scripted: ScriptedRun) -> None:
    funnel = [OUT, np.array([-0.6, 0.0, 0.8]), np.array([0.0, 0.6, 0.8])]
    for header, along in ((on_a_slope(scripted, OUT), 4.0 * ACROSS), (on_a_slope(scripted, *funnel), 4.0 * DOWNHILL)):
        moments = rolled(along, header.bodies)
        camera = CameraFit.of_scene(header, np.zeros(3), moments[0])
        camera.look(moments)
        assert np.sin(np.radians(14.9)) < camera.view().to_eye[2]


def test_a_cup_into_which_bodies_fall_is_seen_from_the_side(scripted: ScriptedRun) -> None:
    ground = on_a_slope(scripted, np.array([0.0, 0.0, 1.0]))
    flat = np.random.default_rng(2).uniform(-1.0, 1.0, size=(20, ground.bodies, 3)) * [1.0, 1.0, 0.05]
    above = dict[str, float]()
    for name, header in (("table", ground), ("cup", replace(ground, shapes=()))):
        camera = CameraFit.of_scene(header, np.zeros(3), flat[0])
        camera.look(flat)
        above[name] = float(np.degrees(np.arcsin(camera.view().to_eye[2])))
    assert above["table"] > 50.0, "swirls on a table are seen from above"
    assert above["cup"] < 35.0, "from above, a cup looks like a sheet"


def test_many_bodies_of_a_pile_are_all_inside() -> None:
    position = np.random.default_rng(4).uniform(-1.0, 1.0, size=(500, 3))
    radius = np.full(500, 0.05)
    view = CameraFit(radius, position).view(1.6, narrow=True)
    assert view.outside == 0 and view.holds(position, radius, 1.6).all()


def test_a_picture_of_one_moment_is_filled_by_it_though_bodies_came_from_far_away(scripted: ScriptedRun) -> None:
    position = next(scripted.frames(1)).position
    radius = scripted.header.radius
    camera = CameraFit(radius, position, motion=CameraMotion.STILL)
    camera.look(position + np.array([100.0, 0.0, 0.0]))
    view = camera.view(narrow=True, trails=False, moment=True)
    places = view.on_screen(position)
    assert np.ptp(places, axis=0).max() > 1.5 and np.abs(places.mean(axis=0)).max() < 0.3


def test_a_legend_larger_than_the_picture_leaves_the_camera_in_front_of_the_bodies() -> None:
    """Its rows would otherwise leave a space of a negative height."""
    first = np.zeros((3, 3)) + np.arange(3.0)[:, None]
    view = CameraFit(np.ones(3), first).view(1.6, inset=(1.2, 1.3))
    assert 0.0 < view.distance < np.inf and view.height() > 0.0
