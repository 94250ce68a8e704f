"""Panels by the events of a run: impacts, lasting contacts, or decades after an explosion."""

from dataclasses import replace
from typing import Any, cast

import numpy as np
import pytest
import rerun.blueprint as rrb
from rerun.components import FillMode

import carom
from carom.display import staging
from carom.display.presentation import Presentation, asked
from carom.display.request import Request
from carom.display.staging import decades
from carom.recording.layout import blueprint
from carom.recording.layout.camera import CameraFit
from carom.recording.layout.canvas import Canvas, views_of
from carom.recording.layout.plot_views import DECADES, grows_by_decades
from carom.recording.read.recorded_scene import header_of_recording, recorded_curves
from carom.recording.read.recording import Recording
from carom.recording.schema import paths
from carom.recording.schema.curve_outline import CurveOutline
from carom.recording.schema.series import recorded
from carom.scene.forces import FORCES
from carom.scene.load import Scene
from carom.scene.scene_file import bundled_scenes
from carom.scene.units.dimension import OF_UNIT
from scripted_run import ScriptedRun
from small_scenes import scene_of

MASS, GRAVITY = 2.0, 9.81


@pytest.fixture(scope="module")
def ball(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    """A ball that bounces twice."""
    return carom.run(Scene.load("bouncing-ball", ["time.duration=1.3"]), tmp_path_factory.mktemp("ball") / "ball.rrd")


@pytest.fixture(scope="module")
def resting(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    """A ball that lies on a floor."""
    scene = scene_of(
        [{"name": "ball", "mass": MASS, "radius": 0.1, "position": [0.0, 0.0, 0.1]}],
        gravity={"constant": 0.0, "uniform": [0.0, 0.0, -GRAVITY]},
        plane=[{"name": "floor", "point": [0.0, 0.0, 0.0]}],
        time={"duration": 0.1, "fixed_dt": 0.01},
        record={"every": "step", "impacts": "auto"},
    )
    return carom.run(scene, tmp_path_factory.mktemp("resting") / "resting.rrd")


def tabs_in_view(shown: Presentation) -> list[str]:
    """Return the names of the plots that are in view, from left to right."""
    rows: Any = shown.supplement.layout.root_container
    plots: Any = list(rows.contents[0].contents)[1]  # left of the legend
    return [str(next(iter(part.contents)).name if isinstance(part, rrb.Tabs) else part.name) for part in plots.contents]


def test_the_strip_has_a_band_for_each_bounce_that_begins_with_it(ball: Recording) -> None:
    shown = asked(ball, Request())
    (strip,) = (rows for rows in shown.supplement.rows if rows.path == paths.IMPACTS)
    (column,) = strip.columns
    assert column.as_arrow_array().flatten().to_pylist() == ["impact 1", "impact 2"]
    assert strip.index.times.tolist() == ball.impacts()["time"].to_pylist()
    *_, strips, _ = cast(list[Any], views_of(shown.supplement.layout.root_container))  # the last one is the legend
    assert paths.IMPACTS in strips.contents and paths.PHASE in strips.contents


def test_impacts_are_in_view_where_impacts_are_and_contacts_where_contacts_last(
    ball: Recording, resting: Recording
) -> None:
    assert tabs_in_view(asked(ball, Request()))[-1] == "Impulse of impacts (N s)"
    assert tabs_in_view(asked(resting, Request()))[-1] == "Contacts"


def test_a_plot_of_very_many_impacts_is_a_tab_behind_others(ball: Recording, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(staging, "MOST_POINTS", 1)
    shown = asked(ball, Request())
    assert tabs_in_view(shown)[-1] != "Impulse of impacts (N s)"
    names = [str(view.name) for view in views_of(shown.supplement.layout.root_container)]
    assert "Impulse of impacts (N s)" in names


def test_the_force_of_a_contact_at_rest_is_the_weight_and_an_impact_has_none(
    ball: Recording, resting: Recording
) -> None:
    forces = resting.steps("contact_force")["contact_force"].to_numpy()
    assert forces[0] == 0.0, "before the first step"
    assert forces[1:] == pytest.approx(MASS * GRAVITY, rel=1e-12), "rounding of a product and a quotient"
    assert not np.any(ball.steps("contact_force")["contact_force"].to_numpy())


@pytest.mark.parametrize(
    ("values", "grows"), [([1.0, 1.2, 5e3], True), ([1.0, 0.1, 1e-9], False), ([1.0, 900.0, 900.0], False)]
)
def test_energies_are_logarithms_if_they_grow_a_thousandfold(values: list[float], grows: bool) -> None:
    assert grows_by_decades([CurveOutline.of(np.arange(3.0), np.array(values))]) is grows


def test_logarithms_of_energies_are_those_of_the_recorded_ones(ball: Recording) -> None:
    header, exploding = header_of_recording(ball), CurveOutline.of(np.arange(3.0), np.array([1.0, 1.0, 1e6]))
    known = {**recorded_curves(ball), "energy/translational": exploding}
    _, rows, _ = decades(ball, header, known)
    (own,) = (each for each in rows if each.path == f"{DECADES}/energy/total")
    (column,) = own.columns
    values = column.as_arrow_array().flatten().to_numpy()
    assert 10.0**values == pytest.approx(ball.energy("total")["total"].to_numpy(), rel=1e-12)
    assert not any(each.path.startswith(DECADES) for each in asked(ball, Request()).supplement.rows), "without one"


def test_the_number_at_the_end_of_the_time_axis_is_inside_a_picture(ball: Recording) -> None:
    shown = asked(ball, Request(), Canvas(1200, 800, rendered=True))
    for view in views_of(shown.supplement.layout.root_container):
        if isinstance(view, rrb.TimeSeriesView):
            axis: Any = view.properties["TimeAxis"]
            end = axis.view_range.as_arrow_array().to_pylist()[0]["end"]
            assert 1.3e9 * 1.04 < end < 1.3e9 * 1.2


def test_every_plot_of_every_bundled_scene_names_the_unit_of_the_scene(ball: Recording) -> None:
    parts: Any = dict.fromkeys(("spins", "has_friction", "stabilises", "promises"), True)
    everything = replace(header_of_recording(ball), forces=frozenset(kind.name for kind in FORCES), **parts)
    named = set[str]()
    for units in {str(scene.unit_system): scene.unit_system for scene in map(Scene.load, bundled_scenes())}.values():
        header = replace(everything, units=units)
        series = {each.path: each.unit for each in recorded(header) if each.plot} | {paths.IMPACTS: "N s"}
        layout = blueprint(header, CameraFit(np.ones(1), np.zeros((1, 3))))
        plots: list[Any] = [view for view in views_of(layout.root_container) if isinstance(view, rrb.TimeSeriesView)]
        for plot in plots:
            (unit,) = {series.pop(str(path)) for path in plot.contents}
            title, end = str(plot.name), "" if unit == "1" else units.labelled("", OF_UNIT[unit])
            assert title.endswith(end) and ("(" in title) == bool(end)
            named.add(title)
        assert not series, "each has a plot"
    assert {"Energy (J)", "dt (s)", "Impulse of impacts (N s)", "dt (day)"} < named


@pytest.mark.parametrize(("bodies", "is_solid"), [(2, False), (300, True)])
def test_in_a_crowd_bodies_are_solid_and_contacts_in_the_other_view(bodies: int, is_solid: bool) -> None:
    """Transparent spheres behind one another, with an edge in each, are a tangle."""
    layout = blueprint(ScriptedRun(bodies).header, CameraFit(np.ones(bodies), np.arange(3.0 * bodies).reshape(-1, 3)))
    first, second, *_ = cast(list[Any], views_of(layout.root_container))
    assert (paths.CONTACTS in first.contents) != is_solid and paths.CONTACTS in second.contents
    drawn = first.visualizer_overrides.get(paths.BODIES, [])
    fills = [one for each in drawn for one in each.overrides if "fill_mode" in str(one.component_descriptor())]
    assert [one.as_arrow_array().to_pylist() for one in fills] == [[FillMode.Solid.value]] * is_solid
