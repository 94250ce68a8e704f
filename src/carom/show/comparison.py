"""Writes two recordings into one for comparison: the bodies of both, lines between counterparts, distances."""

from __future__ import annotations

import hashlib
import uuid
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

import numpy as np
import pyarrow as pa
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import NDArray
from rerun.components import FillMode

from carom.recording.layout.camera import CameraFit, View
from carom.recording.layout.plot_views import whole_time
from carom.recording.read.recording import Recording
from carom.recording.schema import palette, paths
from carom.recording.schema.clock import Clock
from carom.recording.style.curve_style import curve_style
from carom.recording.write.chunk_writer import Writer
from carom.scene.units.dimension import ENERGY, LENGTH, Dimension
from carom.scene.units.system import UnitSystem
from carom.show.answer_layout import beside_bodies

FloatArray = NDArray[np.float64]

PROPERTY = "diff"

_A, _B, _LINES = "world/a/bodies", "world/b/bodies", "world/apart"
_TEXT = "diff"
_SERIES = {
    "rms": ("difference/rms", "rms distance", LENGTH, palette.LINES["red"]),
    "energy": ("difference/energy", "energy difference", ENERGY, palette.LINES["blue"]),
}
_LARGEST = 100_000_000  # bytes of positions; of longer recordings every k-th frame is shown
_BATCH = 4_000_000  # bytes
_SEEN = 0.02  # of the median radius: shorter lines are hidden inside the spheres
_HALO = 1.04  # scale of B's spheres, which those of A would hide at equal size


@dataclass(frozen=True, slots=True)
class Pair:
    """A frame of both recordings."""

    step: int
    time: float  # s
    a: FloatArray  # (n, 3) m
    b: FloatArray  # (n, 3) m


def write_overlay(
    out: Path,
    a: Recording,
    b: Recording,
    pairs: Iterable[Pair],
    count: int,
    series: Mapping[str, FloatArray],
    text: str,
) -> None:
    """Write both recordings into one; ``pairs`` are ``count`` frames, ``series`` has a value for each of them.

    Raises
    ------
    RecordingError
        If it cannot be written.
    """
    radius = a.bodies.radius[a.shown]
    origin = a.origin
    clock = Clock(float(a.info["time_scale"]))
    every = max(1, int(np.ceil(count * len(radius) * 60 / _LARGEST)))
    shown = islice(pairs, 0, None, every)
    logarithms = {name: _logarithm(values)[::every] for name, values in series.items()}
    layout = hashlib.sha256(f"{a.path.name} {b.path.name} {a.scene_toml}".encode()).hexdigest()[:12]
    extent: CameraFit | None = None
    with Writer(out, f"carom-{paths.SCHEMA_VERSION}-{layout}", str(uuid.uuid4())) as writer:
        writer.log(paths.WORLD, rr.ViewCoordinates.RIGHT_HAND_Z_UP)
        writer.log(_TEXT, rr.TextDocument(_document(a, b, text, every), media_type=rr.MediaType.MARKDOWN))
        writer.log(_A, _spheres(radius, palette.SKY, list(a.bodies.name), FillMode.Solid))
        writer.log(_B, _spheres(_HALO * radius, palette.ORANGE, list(a.bodies.name), FillMode.MajorWireframe))
        writer.log(_LINES, rr.LineStrips3D.from_fields(radii=rr.Radius.ui_points(1.5), colors=palette.VERMILION))
        for path, name, dimension, colour in _SERIES.values():
            writer.log(path, curve_style(_heading(name, dimension, a.units), colour))
        own = {"title": f"{a.title}: two runs", **a.units.properties()}
        writer.send_property("carom", {**own, "time_scale": clock.scale, "bodies": len(radius)})
        writer.send_property(PROPERTY, {"a": a.path.name, "b": b.path.name, "verdict": text})
        done = 0
        while batch := list(islice(shown, max(1, _BATCH // (60 * len(radius))))):
            extent = extent or CameraFit(radius, batch[0].a - origin)
            extent.look(batch[-1].a - origin)
            extent.look(batch[-1].b - origin)
            part = {name: values[done : done + len(batch)] for name, values in logarithms.items()}
            _send(writer, clock, batch, origin, _SEEN * float(np.median(radius)), part)
            done += len(batch)
        if extent is not None:
            writer.send_layout(_layout(extent.view(), a.units))
        writer.flush()


def _send(
    writer: Writer, clock: Clock, batch: list[Pair], origin: FloatArray, seen: float, series: Mapping[str, FloatArray]
) -> None:
    index = clock.columns([pair.step for pair in batch], [pair.time for pair in batch])
    each = [len(pair.a) for pair in batch]
    a = np.concatenate([pair.a for pair in batch]) - origin
    b = np.concatenate([pair.b for pair in batch]) - origin
    writer.send_columns(_A, index, rr.Ellipsoids3D.columns(centers=a.astype(np.float32)).partition(each))
    writer.send_columns(_B, index, rr.Ellipsoids3D.columns(centers=b.astype(np.float32)).partition(each))
    apart = np.linalg.norm(b - a, axis=1) > seen
    strips = np.stack([a[apart], b[apart]], axis=1).astype(np.float32)
    lines = [int(np.count_nonzero(part)) for part in np.split(apart, np.cumsum(each)[:-1])]
    writer.send_columns(_LINES, index, rr.LineStrips3D.columns(strips=list(strips)).partition(lines))
    for name, values in series.items():
        writer.send_columns(_SERIES[name][0], index, rr.Scalars.columns(scalars=values))
    times = pa.array([pair.time for pair in batch])
    columns = rr.AnyValues.columns(True, time=times, fingerprint=pa.array([0] * len(batch), pa.uint64()))
    writer.send_columns(paths.FINGERPRINT, index, columns)


def _logarithm(values: FloatArray) -> FloatArray:
    """Take log₁₀; zeros become gaps in the line."""
    with np.errstate(divide="ignore", invalid="ignore"):
        logarithm = np.log10(values)
    return np.where(np.isfinite(logarithm), logarithm, np.nan)


def _spheres(radius: FloatArray, colour: int, names: list[str], fill: FillMode) -> rr.Ellipsoids3D:
    return rr.Ellipsoids3D.from_fields(
        half_sizes=np.repeat(radius.astype(np.float32), 3).reshape(-1, 3),
        colors=colour,
        fill_mode=fill,
        line_radii=rr.Radius.ui_points(0.9),
        labels=names,
        show_labels=False,
    )


def _document(a: Recording, b: Recording, text: str, every: int) -> str:
    lines = [
        f"# {a.title}: two runs",
        text,
        f"- Blue, solid: **A**, {a.path.name}",
        f"- Orange, wires, drawn {_HALO - 1:.0%} larger: **B**, {b.path.name}",
        f"- Red lines join counterparts that are further apart than {_SEEN:.0%} of the median radius.",
        "- The plots are logarithms: a difference that grows exponentially is a straight line.",
    ]
    return "\n".join([*lines, f"- Every {every}th frame is shown." if every > 1 else ""]) + "\n"


def _heading(what: str, dimension: Dimension, units: UnitSystem) -> str:
    unit = units.recorded_unit(dimension.unit)
    return f"log₁₀ of {what}{f' ({unit})' if unit != '1' else ''}"


def _layout(view: View, units: UnitSystem) -> rrb.Blueprint:
    plots = [
        rrb.TimeSeriesView(
            name=_heading(name, dimension, units),
            origin="/",
            contents=[path],
            plot_legend=rrb.PlotLegend(visible=False),
            axis_x=whole_time(),
        )
        for path, name, dimension, _ in _SERIES.values()
    ]
    panels = rrb.Vertical(*plots, rrb.TextDocumentView(name="Verdict", origin=_TEXT), row_shares=[2, 2, 1.5])
    return beside_bodies("A blue, B orange", [_A, _B, _LINES], view, panels)
