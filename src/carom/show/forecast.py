"""Writes how far perturbed branches of a run diverge: bodies shaded by their spread, and a band of distances."""

from __future__ import annotations

import uuid
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
import rerun as rr
import rerun.blueprint as rrb

from carom.arrays import ColourArray, FloatArray
from carom.recording.layout.camera import CameraFit
from carom.recording.layout.canvas import CameraMotion, View
from carom.recording.layout.plot_views import curve_style, whole_time
from carom.recording.read.recording import Recording
from carom.recording.schema import palette, paths
from carom.recording.schema.header import TimeScale
from carom.recording.write.whole_file import Writer
from carom.scene.units.dimension import LENGTH
from carom.scene.units.system import UnitSystem
from carom.show.overlays import BESIDE, beside_bodies

_BODIES, _TEXT = "world/bodies", "fork"
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
# ranges of spread over radius, a factor of ten each, from known to unknown
_SHADES = np.array([0x56B4E9FF, 0x7FC8E8FF, 0xA9DCE5FF, 0xF0E442FF, 0xE69F00FF, 0xD55E00FF], dtype=np.uint32)
_SURE = 1e-5  # spread over radius at which the first shade ends


@dataclass(frozen=True, slots=True)
class Forecast:
    """The content of the drawing."""

    title: str
    text: str  # Markdown
    time: FloatArray  # (k,) s
    position: FloatArray  # (k, n, 3) m
    spread: FloatArray  # (k, n) m
    band: FloatArray  # (3, k) m: 5 %, median and 95 %
    chances: FloatArray  # (c, 4) times of forks (s), and the probability of the outcome: low, measured, high


def shades(spread: FloatArray, radius: FloatArray) -> ColourArray:
    """Return colours of bodies by the spread of their positions (m), from blue, known, to red, unknown."""
    with np.errstate(divide="ignore"):
        decade = np.ceil(np.log10(spread / (_SURE * radius)))
    place = np.clip(np.nan_to_num(decade, nan=0.0, neginf=0.0), 0, len(_SHADES) - 1).astype(np.int64)
    colours: ColourArray = _SHADES[place]
    return colours


def write_forecast(out: Path, recording: Recording, forecast: Forecast) -> None:
    """Write a recording for the viewer. RecordingError if it cannot be written."""
    radius, origin = recording.bodies.radius, recording.origin
    clock = TimeScale(float(recording.info["time_scale"]))
    steps = list(range(len(forecast.time)))
    index = clock.columns(steps, forecast.time.tolist())
    count = [len(radius)] * len(steps)
    shown = forecast.position - origin
    camera = CameraFit(radius, shown[0], motion=CameraMotion.STILL)
    camera.look(shown)
    application = f"carom-{paths.SCHEMA_VERSION}-{uuid.uuid4().hex[:12]}"
    with Writer(out, application, str(uuid.uuid4())) as writer:
        writer.log(paths.WORLD, rr.ViewCoordinates.RIGHT_HAND_Z_UP)
        writer.log(_TEXT, rr.TextDocument(forecast.text, media_type=rr.MediaType.MARKDOWN))
        half = np.repeat(radius.astype(np.float32), 3).reshape(-1, 3)
        names = list(recording.bodies.name)
        solid = rr.components.FillMode.Solid
        writer.log(
            _BODIES, rr.Ellipsoids3D.from_fields(half_sizes=half, fill_mode=solid, labels=names, show_labels=False)
        )
        for path, name, colour in _BAND:
            writer.log(path, curve_style(name, colour))
        own = {"title": forecast.title, **recording.units.properties()}
        writer.send_property("carom", {**own, "time_scale": clock.scale, "bodies": len(radius)})
        writer.send_property("diff", {"a": recording.path.name, "b": "fork", "verdict": forecast.title})
        colours = np.concatenate([shades(row, radius) for row in forecast.spread])
        centres = shown.reshape(-1, 3).astype(np.float32)
        writer.send_columns(_BODIES, index, rr.Ellipsoids3D.columns(centers=centres, colors=colours).partition(count))
        with np.errstate(divide="ignore"):
            logarithms = np.log10(forecast.band / recording.units.factor(LENGTH))
        for (path, _, _), values in zip(_BAND, logarithms, strict=True):
            drawn = np.where(np.isfinite(values), values, np.nan)
            writer.send_columns(path, index, rr.Scalars.columns(scalars=drawn))
        _write_chances(writer, clock, forecast)
        times = pa.array(forecast.time)
        fingerprints = pa.array([0] * len(steps), pa.uint64())
        writer.send_columns(paths.FINGERPRINT, index, rr.AnyValues.columns(True, time=times, fingerprint=fingerprints))
        writer.send_layout(_layout(camera.view(BESIDE.aspect), recording.units, len(forecast.chances) > 0))
        writer.flush()


def _write_chances(writer: Writer, clock: TimeScale, forecast: Forecast) -> None:
    """Write the probability of an outcome over the time of the fork."""
    if not len(forecast.chances):
        return
    times = forecast.chances[:, 0]
    steps = np.searchsorted(forecast.time, times).tolist()
    for (path, name, colour), values in zip(_CHANCE, forecast.chances.T[1:], strict=True):
        writer.log(path, curve_style(name, colour))
        writer.send_columns(path, clock.columns(steps, times.tolist()), rr.Scalars.columns(scalars=values))


def _layout(view: View, units: UnitSystem, has_chances: bool) -> rrb.Blueprint:
    plots = [_plot(f"{units.labelled('log₁₀ of rms distance', LENGTH)}: median, 5 and 95 %", _BAND)]
    if has_chances:
        plots.append(_plot("Probability of the outcome over the time of the fork", _CHANCE))
    text = rrb.TextDocumentView(name="Fork", origin=_TEXT)
    panels = rrb.Vertical(*plots, text, row_shares=[3] * len(plots) + [2])
    return beside_bodies("Bodies by spread: blue is known, red is not", [_BODIES], view, panels)


def _plot(name: str, curves: tuple[tuple[str, str, int], ...]) -> rrb.TimeSeriesView:
    return rrb.TimeSeriesView(name=name, origin="/", contents=[path for path, _, _ in curves], axis_x=whole_time())
