"""The table of scalars is what recordings hold, plots show and the documentation lists."""

from __future__ import annotations

import itertools
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from carom.recording.layout.plot_views import shown_series
from carom.recording.read.recording import Recording
from carom.recording.schema.curve_outline import CurveOutline
from carom.recording.schema.palette import CONTACTS, FRICTION, IMPACTS, LINES, SLATE
from carom.recording.schema.series import PLOTS, SERIES, names_below, recorded
from carom.recording.write.recorder import FrameRecorder
from scripted_run import ScriptedRun

DOCS = Path(__file__).parents[3] / "docs" / "recording.md"


def documented() -> str:
    """The table of docs/recording.md, as it should be."""
    rows = [(f"`/{s.path}`", s.unit, s.meaning, "" if s.part is None else f"`{s.part}`") for s in SERIES]
    lines = ["| entity | unit | meaning | with |", "|---|---|---|---|"]
    return "\n".join([*lines, *("| " + " | ".join(row) + " |" for row in rows)]).replace("|  |", "| |") + "\n"


def test_the_documentation_lists_every_series_with_its_unit_and_meaning() -> None:
    page = DOCS.read_text(encoding="utf-8")
    assert [row for row in documented().splitlines() if row not in page.splitlines()] == []
    assert documented() in page, "in the order of SERIES"


def test_every_plot_shows_at_least_one_series_and_every_plotted_series_has_its_plot() -> None:
    plots = [plot for column in PLOTS for plot in column]
    assert {series.plot for series in SERIES} - {None} == set(plots)
    assert len(set(plots)) == len(plots) and len({series.path for series in SERIES}) == len(SERIES)


@pytest.mark.parametrize(("wrong", "said"), [({"part": "spn"}, "no part spn"), ({"path": "momentum/size"}, "begin")])
def test_a_series_that_no_table_would_have_is_refused_when_it_is_made(wrong: dict[str, str], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        replace(SERIES[0], **wrong)  # type: ignore[arg-type]


def test_the_columns_of_a_table_of_series_have_different_names() -> None:
    for root in ("energy", "step"):
        assert len(set(names_below(root))) == len(names_below(root)) > 0


def test_every_plot_has_one_unit() -> None:
    assert [(series.path, series.unit) for series in SERIES if series.plot and series.unit != series.plot.unit] == []


def test_the_curves_of_a_plot_have_different_colours() -> None:
    refused_together = ("shear", "walls"), ("drag", "passage")  # one of each in a scene
    plots = [plot for column in PLOTS for plot in column]
    for plot, *absent in itertools.product(plots, *refused_together):
        left_out = [f"energy/ledger/{name}" for name in absent]
        colours = [series.colour for series in SERIES if series.plot == plot and series.path not in left_out]
        assert len(set(colours)) == len(colours), plot.title
        assert set(colours) <= {*LINES.values(), CONTACTS, IMPACTS, FRICTION, SLATE}, (
            "others are not legible in both themes"
        )


def test_a_plot_leaves_out_energies_that_are_rounding_errors_of_the_largest() -> None:
    header, time, losses = ScriptedRun(20).header, np.arange(3.0), PLOTS[1][0]
    known = {series.path: CurveOutline.of(time, np.zeros(3)) for series in recorded(header)}
    known["energy/total"] = CurveOutline.of(time, np.array([0.5, 0.5, 0.4]))
    for size, shown in ((1e-16, []), (0.1, ["restitution"])):
        known["energy/ledger/restitution"] = CurveOutline.of(time, np.array([0.0, -size, size]))
        assert [series.legend for series in shown_series(header, losses, known)] == shown


@pytest.mark.parametrize("path", ["energy/relative_error", "step/relative_overlap"])
def test_a_plot_of_errors_or_overlaps_that_are_rounding_is_hidden(path: str) -> None:
    (series,) = (each for each in SERIES if each.path == path)
    assert series.plot is not None
    # billiards: errors of 1e-14 of the energy; a ball on a slope: overlaps of 1e-15 of its radius; orbits: 2e-9
    for size, shown in ((1e-14, False), (2e-9, True)):
        known = {path: CurveOutline.of(np.arange(3.0), np.array([0.0, -size, size]))}
        assert (series in shown_series(ScriptedRun(20).header, series.plot, known)) == shown


def test_a_recording_has_the_series_of_its_scene_and_no_others(tmp_path: Path) -> None:
    for name, scripted in (
        ("all", ScriptedRun(5)),
        ("few", ScriptedRun(5, spins=False, collides=False, forces=frozenset())),
    ):
        with FrameRecorder(tmp_path / f"{name}.rrd", scripted.header) as recorder:
            for frame in scripted.frames(30):
                recorder.put(frame)
            recorder.finish("completed")
        entries = Recording.open(tmp_path / f"{name}.rrd").store.entries
        found = {entry.entity_path for entry in entries if not entry.is_static}
        assert found & {series.path for series in SERIES} == {series.path for series in recorded(scripted.header)}


def test_the_impact_rate_is_impacts_since_the_last_frame_over_the_time_between(tmp_path: Path) -> None:
    scripted = ScriptedRun(5)
    counts = np.array([0, 0, 2, 2, 5, 11, 11, 12])
    frames = [
        replace(frame, books=replace(frame.books, moments=replace(frame.books.moments, impacts=int(impacts))))
        for frame, impacts in zip(scripted.frames(len(counts)), counts, strict=True)
    ]
    with FrameRecorder(tmp_path / "run.rrd", scripted.header, queue_size=3) as recorder:  # several batches
        for frame in frames:
            recorder.put(frame)
        recorder.finish("completed")
    rate = Recording.open(tmp_path / "run.rrd").steps("impact_rate")["impact_rate"].to_numpy()
    times = np.array([frame.time for frame in frames])
    assert rate[0] == 0.0
    assert rate[1:] == pytest.approx(np.diff(counts) / np.diff(times), rel=1e-15)
