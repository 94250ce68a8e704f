"""Writes several runs into one recording: two for comparison, or trajectories over a reference."""

from __future__ import annotations

import hashlib
import uuid
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

import numpy as np
import pyarrow as pa
import rerun as rr
import rerun.blueprint as rrb
from rerun.components import FillMode

from carom.arrays import ColourArray, FloatArray
from carom.display.body_colours import fixed_colours
from carom.display.staging import axes_and_field
from carom.physics.space import Space
from carom.recording.layout import FIELD, WINDOW
from carom.recording.layout.camera import CameraFit
from carom.recording.layout.canvas import CameraMotion, spatial_view
from carom.recording.layout.plot_views import curve_style, time_beside_legend, whole_time
from carom.recording.read.recording import Recording
from carom.recording.schema import palette, paths
from carom.recording.schema.header import Scalar, ShownMaterials, TimeScale
from carom.recording.schema.series import THICK, THIN
from carom.recording.timelines import SIM_TIME
from carom.recording.write.chunk_writer import Writer
from carom.recording.write.rows import time_columns
from carom.scene.units.dimension import ENERGY, LENGTH, Dimension
from carom.scene.units.system import UnitSystem
from carom.scene.wording import literal

BESIDE = WINDOW.area(3 / 5)  # area of the bodies beside panels


def send_beside_bodies(
    writer: Writer,
    name: str,
    contents: Sequence[str],
    camera: CameraFit,
    panels: rrb.Vertical,
    units: UnitSystem,
    drawn: FloatArray,
    radius: FloatArray,
) -> None:
    """Write a layout: a 3D view with a fixed camera, panels on its right, and the axes of space as its scale.

    The axes cover as little as possible of the ``drawn`` spheres, centres (k, 3) m and radii (k,) m.
    """
    view = camera.view(BESIDE.aspect)
    for path, archetype in axes_and_field(units, view, BESIDE, None, drawn, radius):
        writer.log(path, archetype)
    bodies = spatial_view(name, view, [*contents, f"{FIELD}/**"])
    writer.send_layout(paused(rrb.Horizontal(bodies, panels, column_shares=[3, 2])))


def paused(root: rrb.Container) -> rrb.Blueprint:
    """Lay out views that open paused, without the panels around them."""
    return rrb.Blueprint(
        root,
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed", timeline=SIM_TIME, play_state="paused"),
        auto_views=False,
        auto_layout=False,
    )


PROPERTY = "diff"


def begin(
    writer: Writer, entity: str, markdown: str, recording: Recording, title: str, compared: Mapping[str, Scalar]
) -> TimeScale:
    """Write the text and the properties of a comparison with the bodies of a recording; return its scale of time."""
    clock = TimeScale(float(recording.info["time_scale"]))
    writer.log(paths.WORLD, rr.ViewCoordinates.RIGHT_HAND_Z_UP)
    writer.log(entity, rr.TextDocument(markdown, media_type=rr.MediaType.MARKDOWN))
    own: dict[str, Scalar] = {"title": title, **recording.units.properties(), "time_scale": clock.scale}
    writer.send_property("carom", {**own, "bodies": len(recording.bodies.radius)})
    writer.send_property(PROPERTY, {"a": recording.path.name, **compared})
    return clock


def send_times(writer: Writer, index: list[rr.TimeColumn], times: Sequence[float] | FloatArray) -> None:
    """Write the times (s) of frames, without fingerprints, since the frames show several runs."""
    fingerprints = pa.array([0] * len(times), pa.uint64())
    columns = rr.AnyValues.columns(True, time=pa.array(times), fingerprint=fingerprints)
    writer.send_columns(paths.FINGERPRINT, index, columns)


_A, _B, _LINES = "world/a/bodies", "world/b/bodies", "world/apart"
_TEXT = "diff"
_HEADING = "A solid, B in wires; orange lines connect counterparts"
_SERIES = {
    "rms": ("difference/rms", "rms distance", LENGTH, palette.LINES["red"]),
    "energy": ("difference/energy", "energy difference", ENERGY, palette.LINES["blue"]),
}
_LARGEST = 100_000_000  # largest size of positions in bytes; if a recording has more, every k-th frame is shown
_BATCH = 4_000_000  # bytes of a batch
_SEEN = 0.02  # shortest line, in median radii: shorter lines are hidden inside the spheres
_HALO = 1.04  # scale of B's spheres: at equal size, A's spheres would hide them


@dataclass(frozen=True, slots=True)
class MatchedFrames:
    """A frame of both recordings."""

    step: int
    time: float  # s
    a: FloatArray  # (n, 3) m
    b: FloatArray  # (n, 3) m


def write_overlay(
    out: Path,
    a: Recording,
    b: Recording,
    pairs: Iterable[MatchedFrames],
    count: int,
    series: Mapping[str, FloatArray],
    text: str,
) -> None:
    """Write both recordings into one; ``pairs`` yields ``count`` pairs of frames, each with a value of ``series``."""
    radius = a.bodies.radius[a.shown][: len(b.shown)]  # some bodies may enter in one run only
    names, origin = list(a.bodies.name[: len(radius)]), a.origin
    every = max(1, int(np.ceil(count * len(radius) * 60 / _LARGEST)))
    shown = islice(pairs, 0, None, every)
    logarithms = {
        name: logarithm(values / a.units.factor(_SERIES[name][2]))[::every] for name, values in series.items()
    }
    layout = hashlib.sha256(f"{a.path.name} {b.path.name} {a.scene_toml}".encode()).hexdigest()[:12]
    extent: CameraFit | None = None
    with Writer(out, f"carom-{paths.SCHEMA_VERSION}-{layout}", str(uuid.uuid4())) as writer:
        title = f"{a.title}: two runs"
        lines = [
            f"# {literal(title)}",
            literal(text),
            f"- Solid: **A**, {literal(a.path.name)}",
            f"- Wires, drawn {_HALO - 1:.0%} larger: **B**, {literal(b.path.name)}",
            "- A body has the same colour in both.",
            f"- Orange lines connect counterparts that are further apart than {_SEEN:.0%} of the median radius.",
            "- The plots are logarithms: a difference that grows exponentially is a straight line.",
            f"- Every {every}th frame is shown." if every > 1 else "",
        ]
        clock = begin(writer, _TEXT, "\n".join(lines) + "\n", a, title, {"b": b.path.name, "verdict": text})
        colours = fixed_colours(a)[: len(radius)]
        writer.log(_A, spheres(radius, colours, names, FillMode.Solid))
        writer.log(_B, spheres(_HALO * radius, colours, names, FillMode.MajorWireframe))
        writer.log(_LINES, rr.LineStrips3D.from_fields(radii=rr.Radius.ui_points(1.5), colors=palette.VERMILION))
        for path, name, dimension, colour in _SERIES.values():
            writer.log(path, curve_style(_heading(name, dimension, a.units), colour))
        done = 0
        while batch := list(islice(shown, max(1, _BATCH // (60 * len(radius))))):
            extent = extent or CameraFit(radius, batch[0].a - origin, motion=CameraMotion.STILL)
            for pair in batch if extent.is_few else batch[-1:]:
                extent.look(np.array([pair.a, pair.b]) - origin)
            last, both = np.concatenate([batch[-1].a, batch[-1].b]) - origin, np.tile(radius, 2)
            part = {name: values[done : done + len(batch)] for name, values in logarithms.items()}
            _send(writer, clock, batch, origin, _SEEN * float(np.median(radius)), part)
            done += len(batch)
        if extent is not None:
            send_beside_bodies(writer, _HEADING, [_A, _B, _LINES], extent, _panels(a.units), a.units, last, both)
        writer.flush()


def _send(
    writer: Writer,
    clock: TimeScale,
    batch: list[MatchedFrames],
    origin: FloatArray,
    seen: float,
    series: Mapping[str, FloatArray],
) -> None:
    index = time_columns(clock, [pair.step for pair in batch], [pair.time for pair in batch])
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
    send_times(writer, index, [pair.time for pair in batch])


def logarithm(values: FloatArray) -> FloatArray:
    """Return log₁₀; zeros become gaps in the line."""
    with np.errstate(divide="ignore", invalid="ignore"):
        logarithm = np.log10(values)
    return np.where(np.isfinite(logarithm), logarithm, np.nan)


def spheres(radius: FloatArray, colours: ColourArray | None, names: list[str], fill: FillMode) -> rr.Ellipsoids3D:
    """Draw bodies as spheres; ``radius`` is (n,) m."""
    return rr.Ellipsoids3D.from_fields(
        half_sizes=np.repeat(radius.astype(np.float32), 3).reshape(-1, 3),
        colors=colours,
        fill_mode=fill,
        line_radii=rr.Radius.ui_points(0.9),
        labels=names,
        show_labels=False,
    )


def _heading(what: str, dimension: Dimension, units: UnitSystem) -> str:
    return units.labelled(f"log₁₀ of {what}", dimension)


def _panels(units: UnitSystem) -> rrb.Vertical:
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
    return rrb.Vertical(*plots, rrb.TextDocumentView(name="Verdict", origin=_TEXT), row_shares=[2, 2, 1.5])


TRADEOFF_PROPERTY = "tradeoff"

PATHS_UP_TO = 20  # largest number of bodies with paths; with more, only positions are drawn, in the runs' colours
_ROWS = (3, 2)  # heights of the bodies and of the curves below them
_COLUMNS = (2, 3)  # widths of the bodies and of the curves beside them
SMALLEST = 1e-17  # value that replaces the distance 0 on a logarithmic scale


@dataclass(frozen=True, slots=True)
class ComparedTrajectory:
    """One run: its name, the positions of its bodies, and their distance from the reference."""

    name: str
    position: FloatArray  # (K, n, 3) m
    distance: FloatArray  # (K',) distance relative to the size of the system; K' ≤ K, up to the end of the reference
    family: str = ""  # the engine that made the run; runs of one engine share a colour


def write_trajectories(path: Path, space: Space, time: FloatArray, trajectories: list[ComparedTrajectory]) -> None:
    """Write a recording of several runs, which replaces an earlier one.

    Parameters
    ----------
    space
        The scene that ran, for the radii and the colours of its bodies.
    time
        (K,) s.
    trajectories
        The reference, drawn in grey, and then the other runs. Each of their families has a colour, and so has each run
        without a family. Among runs that share a colour, the first has a wide curve. A few bodies are filled with their
        own colours, and have wires and paths in the colour of the run.
    """
    title, radius = space.scene.title, space.state.radius
    bodies = None  # colours of few bodies: by material or by group
    if len(radius) <= PATHS_UP_TO:
        materials = ShownMaterials.of(space.scene)
        bodies = materials.body_colours() if materials and materials.has_colours else palette.body_colours(space.groups)
    clock = TimeScale.fitting(float(time[-1]), float(time[0]))
    origin = trajectories[0].position[0].mean(axis=0)
    layout = hashlib.sha256("\n".join(("tradeoff", title, *(each.name for each in trajectories))).encode()).hexdigest()
    # the colour of each run, and the width of its curve
    hues = [colour for name, colour in palette.LINES.items() if name != "grey"]
    families: dict[str, int] = {}
    colours, widths = [palette.LINES["grey"]], [THIN]
    for run in trajectories[1:]:
        number = families.setdefault(run.family or run.name, len(families))
        colour = hues[number % len(hues)]
        widths.append(THIN if colour in colours else THICK)
        colours.append(colour)
    names = [f"{number:02d}-{_entity(trajectory.name)}" for number, trajectory in enumerate(trajectories)]
    with Writer(path, f"carom-{paths.SCHEMA_VERSION}-{layout[:12]}", str(uuid.uuid4())) as writer:
        writer.log(paths.WORLD, rr.ViewCoordinates.RIGHT_HAND_Z_UP)
        about: dict[str, Scalar] = {
            "title": f"{title}: settings over the reference",
            "time_scale": clock.scale,
            "bodies": len(radius),
        }
        writer.send_property("carom", about)
        writer.send_property(TRADEOFF_PROPERTY, {"courses": "; ".join(each.name for each in trajectories)})
        for name, trajectory, colour, width in zip(names, trajectories, colours, widths, strict=True):
            own = None if bodies is None or trajectory is trajectories[0] else bodies
            _send_trajectories(writer, name, trajectory, colour, own, width, time, radius, origin, clock)
        index = time_columns(clock, list(range(1, len(time) + 1)), time.tolist())
        send_times(writer, index, time)
        legends = [trajectory.name for trajectory in trajectories if len(trajectory.distance)]
        # the camera shows all positions, both above the curves and beside them
        position = trajectories[0].position - origin
        camera = CameraFit(radius, position[0], motion=CameraMotion.STILL)
        camera.look(position)
        areas = WINDOW.area(down=_ROWS[0] / sum(_ROWS)), WINDOW.area(across=_COLUMNS[0] / sum(_COLUMNS))
        views = [(camera.view(area.aspect), area) for area in areas]
        shown = [area.height / view.height() for view, area in views]  # px per metre
        beside = shown[1] > shown[0]
        width = WINDOW.width * (_COLUMNS[1] / sum(_COLUMNS) if beside else 1.0)
        curves = rrb.TimeSeriesView(
            name="log10 of the distance from the reference, over the size",
            origin="/distance",
            plot_legend=rrb.PlotLegend(rrb.Corner2D.RightTop),
            axis_x=time_beside_legend(legends, clock.nanoseconds(time[[0, -1]].tolist()), width),
            axis_y=_decades(trajectories[1:]),
        )
        runs = "colours" if bodies is None else "wires and paths"
        name = f"Reference: grey; runs: {runs}"
        view, area = views[beside]
        ends = np.concatenate([run.position[-1] - origin for run in trajectories])
        for entity, archetype in axes_and_field(
            space.scene.unit_system, view, area, None, ends, np.tile(radius, len(trajectories))
        ):
            writer.log(entity, archetype)
        panels = spatial_view(name, view, [f"/{paths.WORLD}/**", f"{FIELD}/**"]), curves
        side_by_side = rrb.Horizontal(*panels, column_shares=list(_COLUMNS))
        stacked = rrb.Vertical(*panels, row_shares=list(_ROWS))
        writer.send_layout(paused(side_by_side if beside else stacked))
        writer.flush()


def _send_trajectories(
    writer: Writer,
    name: str,
    trajectory: ComparedTrajectory,
    colour: int,
    own: ColourArray | None,
    width: float,
    time: FloatArray,
    radius: FloatArray,
    origin: FloatArray,
    clock: TimeScale,
) -> None:
    position = (trajectory.position - origin).astype(np.float32)
    count, n, _ = position.shape
    index = time_columns(clock, list(range(1, count + 1)), time[:count].tolist())
    bodies = f"world/{name}/bodies"
    writer.log(bodies, rr.Points3D.from_fields(radii=radius.astype(np.float32), colors=colour if own is None else own))
    columns = rr.Points3D.columns(positions=position.reshape(-1, 3)).partition(np.full(count, n))
    writer.send_columns(bodies, index, columns)
    if own is not None:
        wires = f"world/{name}/wires"
        writer.log(wires, spheres(_HALO * radius, np.full(n, colour, np.uint32), [name] * n, FillMode.MajorWireframe))
        centres = rr.Ellipsoids3D.columns(centers=position.reshape(-1, 3)).partition(np.full(count, n))
        writer.send_columns(wires, index, centres)
    if n <= PATHS_UP_TO:
        writer.log(f"world/{name}/paths", rr.LineStrips3D(list(position.transpose(1, 0, 2)), colors=colour))
    if len(trajectory.distance):
        writer.log(f"distance/{name}", curve_style(trajectory.name, colour, width))
        decades = np.log10(np.maximum(trajectory.distance, SMALLEST))
        shown = time_columns(clock, list(range(1, len(decades) + 1)), time[: len(decades)].tolist())
        writer.send_columns(f"distance/{name}", shown, rr.Scalars.columns(scalars=decades))


def _decades(runs: list[ComparedTrajectory]) -> rrb.ScalarAxis | None:
    """Return an axis with whole decades above and below all distances."""
    distances = np.concatenate([np.zeros(0), *(run.distance for run in runs)])
    distances = distances[np.isfinite(distances)]
    if not len(distances):
        return None
    low, high = np.log10(np.maximum([distances.min(), distances.max()], SMALLEST))
    return rrb.ScalarAxis(range=(float(np.floor(low)) - 0.5, float(np.ceil(high)) + 0.5))


def _entity(name: str) -> str:
    """Make a name that needs no escapes in an entity path."""
    words = "".join(character if character.isascii() and character.isalnum() else " " for character in name).split()
    return "-".join(words) or "as-written"
