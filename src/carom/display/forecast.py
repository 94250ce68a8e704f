"""Writes the forecast of a run from its perturbed branches, which diverge, into a recording.

Bodies are shaded by their spread between branches, and a band shows the distances.
"""

from __future__ import annotations

import uuid
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from rerun.components import FillMode

from carom.arrays import ColourArray, FloatArray
from carom.display.overlays import begin, logarithm, send_beside_bodies, send_times, spheres
from carom.recording.layout.camera import CameraFit
from carom.recording.layout.canvas import CameraMotion
from carom.recording.layout.plot_views import curve_style, whole_time
from carom.recording.read.recording import Recording
from carom.recording.schema import palette, paths
from carom.recording.write.chunk_writer import Writer
from carom.recording.write.rows import time_columns
from carom.scene.units.dimension import LENGTH
from carom.scene.wording import literal

_BODIES, _FORK = "world/bodies", "fork"
_BAND = (
    ("spread/low", "5 %", palette.LINES["grey"]),
    ("spread/median", "median", palette.LINES["red"]),
    ("spread/high", "95 %", palette.LINES["blue"]),
)
_CHANCE = (
    ("outcome/low", "95 %, from", palette.LINES["grey"]),
    ("outcome/probability", "probability", palette.LINES["red"]),
    ("outcome/high", "95 %, to", palette.LINES["grey"]),
)
# shades for ranges of the ratio of spread to radius, a factor of ten each, from known to unknown
_SHADES = np.array([0x56B4E9FF, 0x7FC8E8FF, 0xA9DCE5FF, 0xF0E442FF, 0xE69F00FF, 0xD55E00FF], dtype=np.uint32)
_SURE = 1e-5  # ratio of spread to radius at which the first shade ends


@dataclass(frozen=True, slots=True)
class Forecast:
    """The content of the drawing."""

    title: str
    text: str  # Markdown
    time: FloatArray  # (k,) s
    position: FloatArray  # (k, n, 3) m
    spread: FloatArray  # (k, n) m, spread of each body
    band: FloatArray  # (3, k) m, distances: percentile 5, median and percentile 95
    chances: FloatArray  # (c, 4) times of forks (s), and the probability of the outcome: low, measured, high


def shades(spread: FloatArray, radius: FloatArray) -> ColourArray:
    """Return colours of bodies by the spread of their positions (m), from blue, known, to red, unknown."""
    with np.errstate(divide="ignore"):
        decade = np.ceil(np.log10(spread / (_SURE * radius)))
    place = np.clip(np.nan_to_num(decade, nan=0.0, neginf=0.0), 0, len(_SHADES) - 1).astype(np.int64)
    colours: ColourArray = _SHADES[place]
    return colours


def write_forecast(out: Path, recording: Recording, forecast: Forecast) -> None:
    """Write a recording for the viewer; raises RecordingError if it cannot be written."""
    radius, origin, steps = recording.bodies.radius, recording.origin, list(range(len(forecast.time)))
    count = [len(radius)] * len(steps)
    shown = forecast.position - origin
    camera = CameraFit(radius, shown[0], motion=CameraMotion.STILL)
    camera.look(shown)
    application = f"carom-{paths.SCHEMA_VERSION}-{uuid.uuid4().hex[:12]}"
    with Writer(out, application, str(uuid.uuid4())) as writer:
        markdown = f"# {literal(forecast.title)}\n\n{forecast.text}"
        clock = begin(writer, _FORK, markdown, recording, forecast.title, {"b": "fork", "verdict": forecast.title})
        index = time_columns(clock, steps, forecast.time.tolist())
        writer.log(_BODIES, spheres(radius, None, list(recording.bodies.name), FillMode.Solid))
        for path, name, colour in _BAND:
            writer.log(path, curve_style(name, colour))
        colours = np.concatenate([shades(row, radius) for row in forecast.spread])
        centres = shown.reshape(-1, 3).astype(np.float32)
        writer.send_columns(_BODIES, index, rr.Ellipsoids3D.columns(centers=centres, colors=colours).partition(count))
        logarithms = logarithm(forecast.band / recording.units.factor(LENGTH))
        for (path, _, _), values in zip(_BAND, logarithms, strict=True):
            writer.send_columns(path, index, rr.Scalars.columns(scalars=values))
        for (path, name, colour), values in zip(_CHANCE, forecast.chances.T[1:], strict=True):
            if len(values):
                times = forecast.chances[:, 0]
                chance_index = time_columns(clock, np.searchsorted(forecast.time, times).tolist(), times.tolist())
                writer.log(path, curve_style(name, colour))
                writer.send_columns(path, chance_index, rr.Scalars.columns(scalars=values))
        send_times(writer, index, forecast.time)
        plots = [_plot(f"{recording.units.labelled('log₁₀ of rms distance', LENGTH)}: median, 5 and 95 %", _BAND)]
        if len(forecast.chances):
            plots.append(_plot("Probability of the outcome over the time of the fork", _CHANCE))
        text = rrb.TextDocumentView(name="Fork", origin=_FORK)
        panels = rrb.Vertical(*plots, text, row_shares=[3] * len(plots) + [2])
        heading, drawn = "Bodies by spread: blue is known, red is not", shown[-1]
        send_beside_bodies(writer, heading, [_BODIES], camera, panels, recording.units, drawn, radius)
        writer.flush()


def _plot(name: str, curves: tuple[tuple[str, str, int], ...]) -> rrb.TimeSeriesView:
    return rrb.TimeSeriesView(name=name, origin="/", contents=[path for path, _, _ in curves], axis_x=whole_time())
