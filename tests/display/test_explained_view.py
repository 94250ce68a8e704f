"""The annotations of the view: the legend with its scales, names, the arrow of a field; and the light theme."""

import re
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rerun.blueprint import EntityBehavior

import carom
from carom.display import close_up, movie
from carom.display.legend import LegendContents, impact_marks, in_digits, legend
from carom.display.presentation import Presentation, asked
from carom.display.request import Request, shown_step
from carom.display.staging import axes_and_field, names_that_fit
from carom.recording.layout import FIELD, drawing, legend_area
from carom.recording.layout.camera import CameraFit
from carom.recording.layout.canvas import LEGEND, Area, CameraMotion, Canvas, View, free_corner, views_of
from carom.recording.layout.drawing import REACH, magnitude_at, part_of_longest
from carom.recording.read.recorded_scene import header_of_recording
from carom.recording.read.recording import Recording
from carom.recording.schema import palette, paths
from carom.scene.load import Scene
from carom.scene.units import dimension
from carom.scene.units.system import SI, UnitSystem


@pytest.fixture(scope="module")
def bounce(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    """Two named spheres that rub as they meet, without a field."""
    return carom.run(Scene.load("two-spheres", ["record.every=0.25"]), tmp_path_factory.mktemp("bounce") / "bounce.rrd")


@pytest.fixture(scope="module")
def slope(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    """Three balls of three materials on a slope, in a uniform field."""
    return carom.run(Scene.load("incline", ["time.duration=0.1"]), tmp_path_factory.mktemp("slope") / "slope.rrd")


def lines_of(shown: Presentation) -> dict[str, int]:
    """Return the lines of the legend, with their colours."""
    label: Any = dict(shown.supplement.statics)[LEGEND]
    texts, colours = label.labels.as_arrow_array().to_pylist(), label.colors.as_arrow_array().to_pylist()
    return dict(zip((text.strip("\xa0\xad") for text in texts), colours, strict=True))


def test_the_legend_has_every_body_in_its_colour(bounce: Recording) -> None:
    lines = lines_of(asked(bounce, Request()))
    assert [lines["■ left"], lines["■ right"]] == palette.readable([palette.SKY, palette.CLAY], "dark").tolist()


def test_the_legend_has_every_material_in_its_colour(slope: Recording) -> None:
    lines, materials = lines_of(asked(slope, Request())), header_of_recording(slope).materials
    assert materials is not None
    for name, colour in zip(materials.names, materials.colours, strict=True):
        assert [lines[f"■ {name}"]] == palette.readable([colour], "dark").tolist()


@pytest.mark.parametrize("by", ["graph", "island", "speed"])
def test_the_legend_explains_colours_that_are_asked_for(by: str, bounce: Recording) -> None:
    texts = " ".join(lines_of(asked(bounce, Request(colour_by=by))))
    assert {"graph": "colour of the graph", "island": "linked by contacts", "speed": "fast"}[by] in texts


def test_the_legend_names_the_scale_of_every_kind_of_arrow(bounce: Recording) -> None:
    header, lines = header_of_recording(bounce), " ".join(" ".join(lines_of(asked(bounce, Request()))).split())
    (impact,) = bounce.impacts().to_pylist()
    step = shown_step(bounce, bounce.moment(), int(bounce.closing["moments.impact.step"])).frame
    assert step is not None and step.angular_impulse is not None
    assert "lengths compressed; ½, 1, 1½ radii are:" in lines
    # of the only impact, alike on both bodies, so they are the middle of the scale: 1 of 2 radii
    turn = float(np.linalg.norm(step.angular_impulse[0]))
    for path, name, middle, unit in (
        (paths.ANGULAR_IMPULSE, "impact's angular impulse", turn, "N m s"),
        (paths.FORCE_NORMAL, "normal impulse", impact["normal_impulse"], "N s"),  # the only one is the median
    ):
        values = [two_digits(magnitude_at(radii, REACH[path], middle)) for radii in (0.5, 1.0, 1.5)]
        assert f"{name}: {', '.join(values)} {unit}" in lines
    assert f"— contact: {two_digits(impact['normal_impulse'])} N s" in lines
    assert lines.count("— contact") == 1, "there is one, and the legend names no other impulse"
    assert "torque" not in lines, "no contact lasts"
    assert "second number beside it: change of spin" in lines and "impact's change of spin" not in lines
    both = " ".join(" ".join(lines_of(asked(bounce, Request(arrows="both")))).split())
    values = [
        two_digits(magnitude_at(radii, REACH[paths.SPIN_CHANGE], turn / header.inertia[0])) for radii in (0.5, 1.0)
    ]
    assert f"impact's change of spin: {', '.join(values)}," in both
    assert "spin, close up: 1.3 radii = 0.857 rad/s" in lines


def two_digits(value: float) -> str:
    return f"{float(f'{value:.2g}'):g}"


@pytest.mark.parametrize("radii", [0.01, 1.0, 1.9])
def test_an_arrow_of_the_magnitude_that_the_legend_names_has_that_length(radii: float) -> None:
    reference, reach = 3.7, REACH[paths.TORQUE]
    assert reach * part_of_longest(magnitude_at(radii, reach, reference), reference) == pytest.approx(radii, rel=1e-12)


def test_an_arrow_has_the_same_colour_in_the_graph_and_in_the_legend(bounce: Recording) -> None:
    shown = asked(bounce, Request())
    lines, statics = lines_of(shown), dict(shown.supplement.statics)
    for path, word in ((paths.ANGULAR_IMPULSE, "angular impulse"), (paths.FORCE_NORMAL, "normal impulse")):
        arrow: Any = statics[path]
        (colour,) = {colour for text, colour in lines.items() if word in text}
        assert arrow.colors.as_arrow_array().to_pylist() == [colour]
        recorded = bounce._entities.static(path)["Arrows3D:colors"]
        assert [int(each) for each in recorded] == [colour], "as in the file"


def test_of_two_arrows_with_one_direction_the_view_draws_one(bounce: Recording) -> None:
    for arrows, hidden in (("one", {paths.ANGULAR_ACCELERATION, paths.SPIN_CHANGE}), ("both", set())):
        layout = asked(bounce, Request(arrows=arrows), only="graph").supplement.layout
        graph: Any = views_of(layout.root_container)[0]
        found = {path for path, override in graph.visualizer_overrides.items() if isinstance(override, EntityBehavior)}
        assert found == hidden
        assert {*paths.OF_LASTING, *paths.OF_IMPACTS} <= set(graph.contents), "a click shows it"


def test_an_arrow_shows_where_the_field_pulls_and_its_size(slope: Recording, bounce: Recording) -> None:
    statics = dict(asked(slope, Request()).supplement.statics)
    arrows: Any = statics[FIELD]
    vectors = np.array(arrows.vectors.as_arrow_array().to_pylist())
    np.testing.assert_allclose(vectors[0] / np.linalg.norm(vectors[0]), [0, 0, -1], atol=1e-6)  # float32
    np.testing.assert_allclose(vectors[1:] / np.linalg.norm(vectors[1]), np.eye(3), atol=1e-6)
    labels: Any = statics[f"{FIELD}/labels"]
    assert labels.labels.as_arrow_array().to_pylist()[:4] == ["gravity, 9.81 m/s²", "x", "y", "z"]
    floating: Any = dict(asked(bounce, Request(), Canvas(rendered=True)).supplement.statics)[f"{FIELD}/labels"]
    assert floating.labels.as_arrow_array().to_pylist()[:3] == ["x", "y", "z"], "no field"


@pytest.mark.parametrize("size", [1e-9, 1.0, 1e6, 1e15])
def test_axes_are_as_thick_as_they_are_long_at_all_scales(size: float) -> None:
    eye = View(np.zeros(3), 10.0 * size, CameraMotion.STILL, np.array([0.0, -1.0, 0.0]))
    area = Area(800.0, 500.0)
    arrows: Any = dict(axes_and_field(SI, eye, area, None, np.zeros((0, 3)), np.zeros(0)))[FIELD]
    radius = arrows.radii.as_arrow_array().to_pylist()[0]
    points = -radius if radius < 0.0 else radius * area.height / eye.height()  # negative: points of the screen
    assert 0.5 < points < 10.0


@pytest.mark.parametrize("length", ["m", "mm", "au"])
def test_the_axes_have_a_round_length_that_is_written_beside_them(length: str) -> None:
    units = UnitSystem({"length": length})
    area = Area(800.0, 500.0)
    for distance in (0.3, 7.7, 10.0, 4e9):
        eye = View(np.zeros(3), distance, CameraMotion.STILL, np.array([0.0, -1.0, 0.0]))
        drawn: dict[str, Any] = dict(axes_and_field(units, eye, area, None, np.zeros((0, 3)), np.zeros(0)))
        arrows, labels = drawn[FIELD], drawn[f"{FIELD}/labels"]
        vectors = np.array(arrows.vectors.as_arrow_array().to_pylist())
        number, unit = labels.labels.as_arrow_array().to_pylist()[3].removeprefix("axes: ").split(" ")
        assert float(number) == float(f"{float(number):.1g}") and f"{float(number):e}"[0] in "125" and unit == length
        np.testing.assert_allclose(vectors, units.factor(dimension.LENGTH) * float(number) * np.eye(3), rtol=1e-6)
        assert 0.06 < vectors[0, 0] / eye.height() < 0.13, "a tenth of the view, rounded down"


def test_the_arrow_and_the_axes_of_a_field_are_on_the_side_where_they_cover_less() -> None:
    area = Area(800.0, 500.0)
    eye = View(np.zeros(3), 10.0, CameraMotion.STILL, np.array([0.0, -1.0, 0.0]))
    down = np.array([0.0, 0.0, -9.81])
    left = 0.36 * area.aspect * eye.height()  # the half of the picture is 0.5 of it
    for upper, lower in ((-1.0, -1.0), (1.0, -1.0), (-1.0, 1.0), (1.0, 1.0)):
        rows = [(-upper, 0.34), (-lower, -0.36)]  # at a path and a ball: the opposite of an empty place
        drawn = np.array([[side * left, 0.0, up * eye.height()] for side, up in rows])
        arrows: Any = dict(axes_and_field(SI, eye, area, down, drawn, np.array([0.0, 0.3])))[FIELD]
        origins = np.array(arrows.origins.as_arrow_array().to_pylist())
        assert np.sign(origins[[0, 1], 0]).tolist() == [upper, lower]


@pytest.mark.parametrize("steep", [0.0, 0.6, 0.95])
def test_the_length_of_the_axes_is_written_where_no_letter_of_an_axis_is(steep: float) -> None:
    area, aside = Area(800.0, 500.0), np.sqrt(1.0 - steep**2)
    for turn in np.linspace(0.0, 2.0 * np.pi, 17):
        to_eye = np.array([aside * np.cos(turn), aside * np.sin(turn), steep])
        eye = View(np.zeros(3), 10.0, CameraMotion.STILL, to_eye)
        labels: Any = dict(axes_and_field(SI, eye, area, None, np.zeros((0, 3)), np.zeros(0)))[f"{FIELD}/labels"]
        places = eye.on_screen(np.array(labels.positions.as_arrow_array().to_pylist())) * area.height / 2.0
        letters, scale = places[:3], places[3]
        assert np.all(np.abs(letters - scale)[:, 1] > 20.0), "points: the height of a label"
        assert scale[1] - 24.0 > -area.height / 2.0, "Rerun writes a label of 24 points below its place"


def test_the_arrow_of_a_field_under_a_tall_legend_stands_beside_no_axes() -> None:
    area = Area(800.0, 500.0, inset=(200.0, 330.0))
    eye = View(np.zeros(3), 10.0, CameraMotion.STILL, np.array([0.0, -1.0, 0.0]))
    left = -0.36 * area.aspect * eye.height()
    balls = np.array([[left, 0.0, 0.3 * eye.height()], [left, 0.0, -0.36 * eye.height()]])
    down = np.array([0.0, 0.0, -9.81])
    arrows: Any = dict(axes_and_field(SI, eye, area, down, balls, np.full(2, 0.3), (1, 1)))[FIELD]
    origins = np.array(arrows.origins.as_arrow_array().to_pylist())
    apart = np.abs(origins[0] - origins[1])
    assert apart[0] > 0.3 * eye.height() or apart[2] > 0.3 * eye.height()


def test_of_two_names_that_would_overlap_only_that_of_the_larger_body_is_shown(bounce: Recording) -> None:
    header, area = header_of_recording(bounce), Area(400.0, 400.0)
    header = replace(header, radius=header.radius * [0.9, 1.0])
    eye = View(np.zeros(3), 10.0, CameraMotion.STILL, np.array([0.0, -1.0, 0.0]))
    both, larger = tuple(header.names), ("", header.names[1])
    assert names_that_fit(header, np.array([[-2.0, 0, 0], [2.0, 0, 0]]), eye, area) == both
    assert names_that_fit(header, np.array([[0, 0, 1.0], [0, 0, 0]]), eye, area) == both, "one above the other"
    assert names_that_fit(header, np.array([[-0.2, 0, 0], [0.2, 0, 0]]), eye, area) == larger
    assert names_that_fit(header, np.array([[-0.2, 0, 0], [0.2, 9.0, 0]]), eye, area) == larger, "one behind the other"


def test_where_names_would_overlap_bodies_that_differ_by_a_number_show_the_number(bounce: Recording) -> None:
    header, area = header_of_recording(bounce), Area(400.0, 400.0)
    header = replace(header, radius=np.ones(3), names=["cue ball", "ball 1", "ball 12"], mass=np.ones(3))
    eye = View(np.zeros(3), 10.0, CameraMotion.STILL, np.array([0.0, -1.0, 0.0]))
    wide, near = (np.array([[-3.0, 0, 0], [x, 0, 0], [2 * x, 0, 0]]) for x in (2.0, 0.8))
    assert names_that_fit(header, wide, eye, area) == ("cue ball", "ball 1", "ball 12")
    assert names_that_fit(header, near, eye, area) == ("cue ball", "1", "12")


def test_without_friction_the_legend_names_none(tmp_path: Path) -> None:
    straight = ["body.0.position=[-2, 0, 0]", "body.1.position=[2, 0, 0]", "record.every=0.25"]
    head_on = carom.run(Scene.load("two-spheres", straight), tmp_path / "head-on.rrd")
    assert header_of_recording(head_on).has_friction
    texts = " ".join(lines_of(asked(head_on, Request())))
    assert "normal impulse" in texts and "friction" not in texts
    assert "torque" not in texts and "angular impulse" not in texts


@pytest.mark.parametrize("view", ["bodies", "graph", "close-up"])
def test_a_picture_of_one_view_has_a_legend_of_what_this_view_shows(view: str, bounce: Recording) -> None:
    shown = asked(bounce, Request(event="impact:1"), Canvas(800, 500, framed=False, rendered=True), view)
    lines = " ".join(lines_of(shown))
    for text, views in {
        "path so far": ["bodies"],
        "impact: size": ["bodies"],
        "impulse of friction": ["graph"],
        "angular impulse": ["graph", "close-up"],
        "impulse on each body": ["close-up"],
    }.items():
        assert (text in lines) == (view in views), text
    (only,) = views_of(shown.supplement.layout.root_container)
    assert LEGEND in str(only.contents)
    before = asked(bounce, Request(at=0.5), Canvas(800, 500, framed=False, rendered=True), "bodies")
    assert "impact" not in " ".join(lines_of(before)), "not before there is one"


@pytest.mark.parametrize(
    ("number", "text"), [(45400.0, "45400 N s"), (3.25e7, "3.25e+07 N s"), (0.0123456, "0.0123 N s")]
)
def test_numbers_below_a_million_have_no_exponent(number: float, text: str) -> None:
    assert in_digits(SI, number, dimension.IMPULSE) == text


def test_the_contacts_of_a_crowd_are_seen_from_near() -> None:
    position = np.stack(np.meshgrid(*3 * [np.arange(5.0)], indexing="ij"), axis=-1).reshape(-1, 3)
    camera = CameraFit(np.full(len(position), 0.5), position)
    few = camera.of([0, 1])
    assert few.view().distance < 0.5 * camera.view().distance
    np.testing.assert_allclose(few.view().to_eye, camera.view().to_eye)


@pytest.mark.parametrize("wide", [0.1, 1.0, 4.0])
def test_a_legend_in_a_picture_covers_no_body(wide: float) -> None:
    random = np.random.default_rng(1)
    for _ in range(20):
        position, radius = random.uniform(-1.0, 1.0, (8, 3)) * [wide, 1.0, 1.0], random.uniform(0.05, 0.2, 8)
        camera, inset = CameraFit(radius, position), (random.uniform(0.1, 0.5), random.uniform(0.1, 0.5))
        view = camera.view(1.6, narrow=True, inset=inset)
        assert view.holds(position, radius, 1.6).all()
        assert free_corner(view, 1.6, inset, position, radius) is not None


def test_the_point_of_an_impact_is_inside_the_picture(tmp_path: Path) -> None:
    bouncing = carom.run(Scene.load("bouncing-ball", ["time.duration=0.5"]), tmp_path / "bouncing.rrd")
    marks = impact_marks(bouncing, header_of_recording(bouncing), bouncing.impacts()["time"][0].as_py())
    assert len(marks) == 26, "around one point"
    first, radius = np.array([[0.0, 0.0, 0.1]]), np.array([0.1])
    camera = CameraFit(radius, first)
    below = np.array([[0.0, 0.0, -5.0]])
    for tips, inside in ((None, False), (below, True)):
        view = camera.view(1.6, narrow=True, tips=tips)
        assert view.holds(below, np.zeros(1), 1.6)[0] == inside


def luminance(colour: int) -> float:
    return sum(weight * ((colour >> shift) & 0xFF) for weight, shift in ((0.2126, 24), (0.7152, 16), (0.0722, 8))) / 255


def relative_luminance(colour: int) -> float:
    """Return the relative luminance of WCAG 2."""
    shares = [((colour >> shift) & 0xFF) / 255 for shift in (24, 16, 8)]
    linear = [share / 12.92 if share <= 0.04045 else ((share + 0.055) / 1.055) ** 2.4 for share in shares]
    return float(np.dot([0.2126, 0.7152, 0.0722], linear))


@pytest.mark.parametrize(("theme", "label"), [("dark", 0x1B1D20FF), ("light", 0xEFEFEFFF)])
def test_every_word_of_a_legend_has_a_contrast_of_four_and_a_half_to_one(theme: str, label: int) -> None:
    """The colours of labels are those that pictures of the viewer show."""
    known = (*palette.BODIES, *palette.STAGES, *palette.ARROWS.values(), palette.SPIN, palette.FIELD, palette.GREY)
    shades = palette.body_colours(np.zeros(200, dtype=np.int64))  # of one group, down to dark ones
    for colour in palette.readable([*known, *drawing.COLOURS, *drawing.SPEEDS, *shades], theme).tolist():
        darker, lighter = sorted([relative_luminance(colour), relative_luminance(label)])
        assert (lighter + 0.05) / (darker + 0.05) >= 4.45, f"{colour:08x}"  # 1 % for the rounding to 8 bits


@pytest.mark.parametrize("bodies", [2, 16, 300])
def test_a_legend_is_whole_in_a_window_of_1280_by_720(bodies: int, bounce: Recording) -> None:
    """Sixteen bodies, and all arrows, edges and units that there are; of many groups, some lines are folded."""
    contents = LegendContents(*[True] * len(fields(LegendContents)))
    many = -np.ones(bodies, dtype=np.int64) if bodies < 100 else np.arange(bodies)
    header = replace(
        header_of_recording(bounce),
        group=many,
        radius=np.ones(bodies),
        names=[f"a long name {k}" for k in range(bodies)],
    )
    references = {paths.TORQUE: 1234.5, paths.ANGULAR_ACCELERATION: 1.2345e-7}
    lines = (header, "group", palette.body_colours(many), references, None, contents)
    field = np.array([0.0, 0.0, -9.81])
    words = legend(*lines, fastest=1e3, field=field, viewer_time="1 s of the viewer is 1000 year")
    area = legend_area(Canvas())
    ((_, shown),) = words.beside(area).statics
    labels: Any = shown
    heights = np.array(labels.positions.as_arrow_array().to_pylist())[:, 1]
    chip = 23.0  # points, height of a label
    assert heights[-1] + chip <= area.height <= 720 - 70 - 24
    assert (np.diff(heights) >= chip).all(), "no label covers another"
    assert max(line.width for line in words.fitted(area).entries) <= area.width <= 0.2 * 1280
    texts = " ".join(" ".join(line.text for line in words.fitted(area).entries).split())
    assert "a long name" in texts and "angular acceleration" in texts and "of the viewer" in texts
    assert bodies == 2 or f"and {bodies - texts.count('a long name')} more" in texts


@pytest.mark.parametrize("view", ["all", "bodies", "graph", "close-up"])
def test_the_light_theme_is_light_everywhere(view: str, slope: Recording) -> None:
    shown = asked(slope, Request(), Canvas(theme="light"), view)
    grounds = _grounds(shown.supplement.layout.root_container)
    assert len(grounds) == (4 if view == "all" else 1) and set(grounds) == {palette.WHITE}
    for path, archetype in shown.supplement.statics:
        colours = getattr(archetype, "colors", None)
        if colours is not None and path != close_up.FOLLOWED:  # points that are not to be seen
            assert all(luminance(int(each)) < 0.75 for each in colours.as_arrow_array().to_pylist()), path
    sent = [rows for rows in shown.supplement.rows if rows.path == paths.BODIES]
    assert any("Points3D:colors" in str(column.component_descriptor()) for rows in sent for column in rows.columns)


@pytest.mark.parametrize("theme", ["dark", "light"])
def test_the_legend_explains_what_an_edges_width_and_colour_mean(theme: str, slope: Recording) -> None:
    lines = lines_of(asked(slope, Request(), Canvas(theme=theme)))
    (text,) = (text for text in lines if text.startswith("— contact"))  # alike on all three balls
    assert re.match(f"— contact{', medium line' if theme == 'light' else ''}: [0-9.]+", text), "the scale"
    header, contents = header_of_recording(slope), LegendContents(contacts=True, impulses=True)
    unknown = legend(header, "group", None, {}, None, contents, theme=theme).entries  # during a whole run
    edges = [line.colour for line in unknown if line.text.startswith("— contact")]
    assert len(edges) == 3 and len(set(edges)) == (3 if theme == "dark" else 1), "on paper only the width has a meaning"


@pytest.mark.parametrize("theme", ["dark", "light"])
def test_a_picture_of_all_views_says_what_happens_and_groups_its_legend_by_view(theme: str, bounce: Recording) -> None:
    shown = asked(bounce, Request(), Canvas(rendered=True, theme=theme))
    texts = [" ".join(text.split()) for text in lines_of(shown)]
    # the step ends later than the impact
    what = r"Two spheres off centre, with friction t = 1\.6 s, in the step to 1\.6\d+ s: left meets right with"
    assert re.match(rf"{what} the most energy of the run ■ left", " ".join(texts))
    names = [str(view.name) for view in views_of(shown.supplement.layout.root_container)]
    graph, close = (texts.index(f"{name}:") for name in names[1:3])
    impulse, spin = (
        next(k for k, text in enumerate(texts) if text.startswith(f"→ {what}")) for what in ("normal i", "spin")
    )
    assert graph < impulse < close < spin
    assert not any(text.startswith("speed") for text in texts[:close]), "numbers of the close-up stand once"
    labels, _ = (rows for rows in shown.supplement.rows if rows.path == close_up.LABELS)  # the second clears the first
    column = next(each for each in labels.columns if str(each.component_descriptor()).endswith("labels"))
    assert column.as_arrow_array().flatten().to_pylist() == [
        "759 N s",
        "0.857 rad/s",
        "0.857 rad/s",
        "0.77 m/s",
        "0.77 m/s",
    ]


def test_a_legend_without_room_leaves_out_headings_and_not_arrows(bounce: Recording) -> None:
    words = legend(header_of_recording(bounce), "group", None, {}, None, LegendContents(*[True] * 7))
    grouped = words.grouped("Impulses and torques", {})
    tight = Area(300.0, 25.0 * len(list(words.fitted(Area(300.0, 1e4)).entries)) + 10.0)
    assert any(line.text == "Impulses and torques:" for line in grouped.fitted(Area(300.0, 1e4)).entries)
    assert {line.text for line in grouped.fitted(tight).entries} == {line.text for line in words.fitted(tight).entries}


def test_the_grid_of_a_plane_has_squares_of_a_round_size_that_the_legend_states(slope: Recording) -> None:
    shown = asked(slope, Request(), Canvas(rendered=True))
    (text,) = (text for text in lines_of(shown) if text.startswith("— grid"))
    side = float(text.split()[-2])
    assert f"{side:e}"[0] in "125"
    grid: Any = dict(shown.supplement.statics)[paths.PLANES]
    lines = np.array([np.array(line) for line in grid.strips.as_arrow_array().to_pylist()])
    apart = np.linalg.norm(np.diff(lines[: len(lines) // 2, 0], axis=0), axis=1)
    np.testing.assert_allclose(apart, side, rtol=1e-4)  # float32


def test_axes_cover_a_path_rather_than_a_body() -> None:
    area = Area(800.0, 500.0)
    eye = View(np.zeros(3), 10.0, CameraMotion.STILL, np.array([0.0, -1.0, 0.0]))
    low, wide = -0.36 * eye.height(), 0.36 * area.aspect * eye.height()
    balls = np.array([[-wide, 0.0, low], [0.0, 0.0, low], [wide, 0.0, low]])
    path = np.stack([np.full(50, -wide), np.zeros(50), np.linspace(low, -low, 50)], axis=1)
    drawn, radius = np.concatenate([balls, path]), np.pad(np.full(3, 0.3), (0, 50))
    arrows: Any = dict(axes_and_field(SI, eye, area, None, drawn, radius))[FIELD]
    origin = np.array(arrows.origins.as_arrow_array().to_pylist())[0]
    assert np.linalg.norm(balls - origin, axis=1).min() > 0.3 * eye.height()


def _grounds(part: Any) -> list[int]:
    """Return the grounds of the 2D and 3D views of a layout."""
    if hasattr(part, "contents") and not hasattr(part, "properties"):
        return [ground for inner in part.contents for ground in _grounds(inner)]
    background = part.properties.get("Background")
    return [] if background is None else background.color.as_arrow_array().to_pylist()


def test_a_movie_on_paper_has_the_same_grounds_and_colours(slope: Recording) -> None:
    times = slope.fingerprints()["time"].to_pylist()
    supplement = movie._layout(slope, times, Canvas(800, 500, theme="light"), "all")
    assert set(_grounds(supplement.layout.root_container)) == {palette.WHITE}
    (rows,) = (rows for rows in supplement.rows if rows.path == paths.BODIES)
    (column,) = rows.columns
    materials = header_of_recording(slope).materials
    assert materials is not None
    assert column.as_arrow_array().to_pylist()[0] == palette.legible(materials.body_colours(), "light").tolist()
