"""Writes several runs of one scene into one recording: trajectories over a reference, and distances from it."""

from __future__ import annotations

import hashlib
import uuid
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import NDArray

from carom.recording.layout.blueprint import WINDOW
from carom.recording.layout.camera import CameraFit, View
from carom.recording.layout.legend import time_beside_legend
from carom.recording.layout.spatial_view import spatial_view
from carom.recording.schema import palette, paths
from carom.recording.schema.clock import Clock
from carom.recording.schema.header import Scalar
from carom.recording.schema.series import THICK, THIN
from carom.recording.style.curve_style import curve_style
from carom.recording.write.chunk_writer import Writer
from carom.show.answer_layout import paused

FloatArray = NDArray[np.float64]

PROPERTY = "tradeoff"

PATHS_UP_TO = 20  # bodies; with more, only positions are drawn, not paths
SMALLEST = 1e-17  # shown in place of distance 0 on a logarithmic scale


@dataclass(frozen=True, slots=True)
class ComparedTrajectory:
    """One run: its name, the positions of its bodies, and their distance from the reference."""

    name: str
    position: FloatArray  # (K, n, 3) m
    distance: FloatArray  # (K',) of the size of the system; K' ≤ K, up to where there is a reference
    family: str = ""  # the engine that made it, whose runs share a colour


def write_trajectories(
    path: Path, title: str, time: FloatArray, radius: FloatArray, trajectories: list[ComparedTrajectory]
) -> None:
    """Write a recording of several runs.

    Parameters
    ----------
    path
        The ``.rrd``, in place of an earlier one.
    time
        (K,) s.
    radius
        (n,) m.
    trajectories
        The reference first, which is drawn grey. Each family of the others has a colour, and each run without a family;
        of those that share one, the first has a wide curve.

    Raises
    ------
    RecordingError
        If it cannot be written.
    """
    clock = Clock.fitting(float(time[-1]), float(time[0]))
    origin = trajectories[0].position[0].mean(axis=0)
    layout = hashlib.sha256("\n".join(("tradeoff", title, *(each.name for each in trajectories))).encode()).hexdigest()
    colours, widths = _styles(trajectories)
    names = [f"{number:02d}-{_entity(trajectory.name)}" for number, trajectory in enumerate(trajectories)]
    with Writer(path, f"carom-{paths.SCHEMA_VERSION}-{layout[:12]}", str(uuid.uuid4())) as writer:
        writer.log(paths.WORLD, rr.ViewCoordinates.RIGHT_HAND_Z_UP)
        about: dict[str, Scalar] = {
            "title": f"{title}: settings over the reference",
            "time_scale": clock.scale,
            "bodies": len(radius),
        }
        writer.send_property("carom", about)
        writer.send_property(PROPERTY, {"courses": "; ".join(each.name for each in trajectories)})
        for name, trajectory, colour, width in zip(names, trajectories, colours, widths, strict=True):
            _send(writer, name, trajectory, colour, width, time, radius, origin, clock)
        index = clock.columns(list(range(1, len(time) + 1)), time.tolist())
        frames = rr.AnyValues.columns(True, time=pa.array(time), fingerprint=pa.array([0] * len(time), pa.uint64()))
        writer.send_columns(paths.FINGERPRINT, index, frames)
        legends = [trajectory.name for trajectory in trajectories if len(trajectory.distance)]
        axis = time_beside_legend(legends, clock.nanoseconds(time[[0, -1]].tolist()), WINDOW.width)
        writer.send_layout(_layout(_view(radius, trajectories[0].position - origin), axis))
        writer.flush()


def _styles(trajectories: list[ComparedTrajectory]) -> tuple[list[int], list[float]]:
    """Return the colour of each run, and the width of its curve."""
    hues = [colour for name, colour in palette.LINES.items() if name != "grey"]
    families: dict[str, int] = {}
    colours, widths = [palette.LINES["grey"]], [THIN]
    for run in trajectories[1:]:
        number = families.setdefault(run.family or run.name, len(families))
        colour = hues[number % len(hues)]
        widths.append(THIN if colour in colours else THICK)
        colours.append(colour)
    return colours, widths


def _send(
    writer: Writer,
    name: str,
    trajectory: ComparedTrajectory,
    colour: int,
    width: float,
    time: FloatArray,
    radius: FloatArray,
    origin: FloatArray,
    clock: Clock,
) -> None:
    position = (trajectory.position - origin).astype(np.float32)
    count, n, _ = position.shape
    index = clock.columns(list(range(1, count + 1)), time[:count].tolist())
    bodies = f"world/{name}/bodies"
    writer.log(bodies, rr.Points3D.from_fields(radii=radius.astype(np.float32), colors=colour))
    columns = rr.Points3D.columns(positions=position.reshape(-1, 3)).partition(np.full(count, n))
    writer.send_columns(bodies, index, columns)
    if n <= PATHS_UP_TO:
        writer.log(f"world/{name}/paths", rr.LineStrips3D(list(position.transpose(1, 0, 2)), colors=colour))
    if len(trajectory.distance):
        writer.log(f"distance/{name}", curve_style(trajectory.name, colour, width))
        decades = np.log10(np.maximum(trajectory.distance, SMALLEST))
        shown = clock.columns(list(range(1, len(decades) + 1)), time[: len(decades)].tolist())
        writer.send_columns(f"distance/{name}", shown, rr.Scalars.columns(scalars=decades))


def _view(radius: FloatArray, position: FloatArray) -> View:
    """Place the camera so that it sees all positions, (K, n, 3) m."""
    camera = CameraFit(radius, position[0])
    for moment in position:
        camera.look(moment)
    return replace(camera.view(), follows=False)


def _layout(view: View, time: rrb.TimeAxis) -> rrb.Blueprint:
    return paused(
        rrb.Vertical(
            spatial_view("Settings over the reference", view, [f"/{paths.WORLD}/**"]),
            rrb.TimeSeriesView(
                name="log10 of the distance from the reference, over the size",
                origin="/distance",
                plot_legend=rrb.PlotLegend(rrb.Corner2D.RightTop),
                axis_x=time,
            ),
            row_shares=[3, 2],
        )
    )


def _entity(name: str) -> str:
    """Make a name that needs no escapes in an entity path."""
    words = "".join(character if character.isascii() and character.isalnum() else " " for character in name).split()
    return "-".join(words) or "as-written"
