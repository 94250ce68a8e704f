"""`Supplement`: rows and a layout that a viewer gets in addition to a recording; the file does not change.

Such rows are trails (the paths of a few bodies up to the shown moment), and plots of single bodies: position, velocity
and spin over time, requested as ``top.z, top.omega``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from carom.arrays import ColourArray, FloatArray, IntArray, SingleArray
from carom.errors import RecordingError
from carom.recording.layout import TRAILS
from carom.recording.layout.camera import FEW, CameraFit
from carom.recording.layout.canvas import Area
from carom.recording.layout.plot_views import curve_style, time_series_view
from carom.recording.read.frame_rows import drawn_paths, times_of
from carom.recording.read.lookup import body_number, split_at_commas
from carom.recording.read.recording import Recording
from carom.recording.schema import palette
from carom.recording.schema.curve_outline import CurveOutline
from carom.recording.schema.header import Header, TimeScale
from carom.recording.timelines import STEP
from carom.recording.write.durable_sink import FLUSH
from carom.recording.write.rerun_compat import send_layout
from carom.recording.write.rows import Index, Rows, time_columns
from carom.runs.window import Window
from carom.scene.units.dimension import OF_UNIT
from carom.scene.units.system import SI, UnitSystem
from carom.scene.wording import body_called

if TYPE_CHECKING:
    from carom.display.request import ShownStep
    from carom.physics.simulation import StepStatus

Static = tuple[str, rr.AsComponents]


@dataclass(frozen=True, slots=True)
class Supplement:
    """Rows, static data and a layout, sent to a viewer that shows the recording."""

    layout: rrb.Blueprint
    clock: TimeScale  # clock of the recording
    rows: Sequence[Rows] = ()
    statics: Sequence[Static] = ()

    def send(self, address: str, application: str, recording_id: str) -> None:
        """Send the supplement to the recording with these ids, in the viewer at an address."""
        self._put(rr.GrpcSink(address), application, recording_id)

    def save(self, path: Path, application: str, recording_id: str) -> None:
        """Write the supplement to a file, which a viewer loads in addition to the recording with these ids."""
        self._put(rr.FileSink(path), application, recording_id)

    def _put(self, sink: rr.GrpcSink | rr.FileSink, application: str, recording_id: str) -> None:
        with rr.RecordingStream(application, recording_id=recording_id, send_properties=False) as stream:
            stream.set_sinks(sink)
            for path, archetype in self.statics:
                stream.log(path, archetype, static=True)
            for rows in self.rows:
                stream.send_columns(rows.path, time_columns(self.clock, *rows.index), rows.columns)
            send_layout(stream, application, self.layout)
            stream.flush(timeout_sec=FLUSH)
            stream.disconnect()


_MOST_FRAMES = 2000  # largest number of frames in a path; if there are more, every k-th frame is used
_TANGLED = 20.0  # paths that are longer in total than this, in sizes of the space that they fill, are a tangle
_POINTS = 1000  # smallest number of points of a smooth path, since integrators of high order take long steps


class Trails:
    """The paths of all bodies of a recording, as pieces from frame to frame.

    If nothing ever touched, a piece is part of the cubic spline through all frames. ``colours``, (n,), are the colours
    of the bodies. The paths also pass through the positions in a ``repeated`` step between two frames.
    """

    def __init__(
        self, recording: Recording, header: Header, colours: ColourArray, repeated: ShownStep | None = None
    ) -> None:
        drawn = drawn_paths(recording, range(len(header.radius)))
        every = -(-len(drawn.steps) // _MOST_FRAMES)
        self._steps = drawn.steps[::every]
        self._times = times_of(recording, self._steps)
        self._position = drawn.position[::every]
        if repeated is not None and repeated.frame is not None and repeated.step not in self._steps:
            place = int(np.searchsorted(self._steps, repeated.step))
            self._steps = np.insert(self._steps, place, repeated.step)
            self._times = np.insert(self._times, place, repeated.time)
            self._position = np.insert(self._position, place, repeated.position, axis=0)
        self._box, self._shear = header.box, header.shear
        untouched = recording.closing.get("contacts.total") == 0 and header.box is None
        self._is_smooth = untouched and bool((np.diff(self._times) > 0.0).all())
        self._colours = colours
        self.recent = None if untouched else self._untangled()

    def _untangled(self) -> float | None:
        """Return the time (s) for which paths are drawn if whole paths would be a tangle that hides the bodies."""
        pieces = np.linalg.norm(np.diff(self._position, axis=0), axis=2)
        size = float(np.ptp(self._position, axis=(0, 1)).max(initial=0.0))
        total = float(pieces.sum(where=pieces < 0.5 * size))  # longer pieces cross the border of a box
        if not total > _TANGLED * size:
            return None
        return float(f"{(self._times[-1] - self._times[0]) * _TANGLED * size / total:.1g}")

    def steps_of(self, time: float) -> int:
        """Return how many steps a time (s) takes on average, at least one."""
        span = float(self._times[-1] - self._times[0])
        return max(1, round((int(self._steps[-1]) - int(self._steps[0])) * time / span)) if span > 0.0 else 1

    def show(self, camera: CameraFit, until: float = np.inf) -> None:
        """Fit a camera: the paths drawn up to a time (s) are in view, and its direction suits the whole motion."""
        position, past = self._position.astype(np.float64), self._times <= until
        camera.look(position[past])
        camera.look(position[~past], inside=False)

    def until(self, time: float) -> FloatArray:
        """Return the points of the paths up to a time (s), (k, 3) m."""
        return np.asarray(self._position[self._times <= time].reshape(-1, 3), dtype=np.float64)

    def statics(self) -> Iterable[Static]:
        """Yield the colours of the bodies."""
        yield TRAILS, rr.LineStrips3D.from_fields(colors=self._colours, radii=rr.Radius.ui_points(0.75))

    def rows(self) -> Iterable[Rows]:
        """Yield the pieces, each at the frame where it ends; pieces that cross the border of a box have no length."""
        pieces, bodies = len(self._times) - 1, self._position.shape[1]
        if pieces < 1:
            return
        points = self._points(-(-_POINTS // pieces) if self._is_smooth else 1)
        strips = points.transpose(0, 2, 1, 3).reshape(pieces * bodies, -1, 3)
        columns = rr.LineStrips3D.columns(strips=list(strips)).partition([bodies] * pieces)
        yield Rows(TRAILS, Index(self._steps[1:], self._times[1:]), columns)

    def _points(self, parts: int) -> SingleArray:
        """Return the points of all pieces, (pieces, parts + 1, n, 3) m."""
        begin, end = self._position[:-1], self._position[1:]
        if self._box is not None:
            leaves = np.abs(end - begin) > self._box / 2
            if self._shear:  # the image is displaced along the flow, too
                flow, gradient = self._shear.axes
                leaves[..., flow] |= leaves[..., gradient]
            end = np.where(leaves, begin, end)
        if parts == 1:
            return np.stack([begin, end], axis=1)
        from scipy.interpolate import CubicSpline  # noqa: PLC0415 - slow to import, and most commands draw no trails

        times = self._times[:-1, np.newaxis] + np.diff(self._times)[:, np.newaxis] * np.linspace(0.0, 1.0, parts + 1)
        curve: SingleArray = CubicSpline(self._times, self._position)(times).astype(np.float32)
        return curve


def has_trails(recording: Recording) -> bool:
    """Return whether a recording has few enough bodies for their paths to be legible."""
    return len(recording.shown) <= FEW and recording.frames > 1


MOST = 12  # largest number of curves that can be distinguished


@dataclass(frozen=True, slots=True)
class Quantity:
    """A number that a body has at every frame."""

    name: str
    unit: str
    vector: str  # name of a vector of the state
    axis: int | None  # the component of the vector; None for the magnitude of the vector

    def of(self, vectors: FloatArray) -> FloatArray:
        """Compute the curve from the vectors of all frames, (k, 3)."""
        return vectors[:, self.axis] if self.axis is not None else np.sqrt(np.einsum("ki,ki->k", vectors, vectors))


_VECTORS = (
    ("position", "m", ("x", "y", "z"), ""),
    ("velocity", "m/s", ("vx", "vy", "vz"), "speed"),
    ("angular_velocity", "rad/s", ("wx", "wy", "wz"), "omega"),
)
QUANTITIES = {
    name: Quantity(name, unit, vector, axis)
    for vector, unit, axes, length in _VECTORS
    for name, axis in (*((each, k) for k, each in enumerate(axes)), *([(length, None)] if length else []))
}


@dataclass(frozen=True, slots=True)
class BodySeries:
    """A quantity of a body over the frames of a recording."""

    body: int
    name: str  # name of the body
    quantity: Quantity
    step: IntArray  # (k,)
    time: FloatArray  # (k,) s
    value: FloatArray  # (k,) values in the unit of the quantity


def asked_quantities(recording: Recording, text: str, *, one_unit: bool = False) -> list[tuple[int, Quantity]]:
    """Read the requested quantities of bodies, ``BODY.QUANTITY`` separated by commas; bodies have numbers or names.

    With ``one_unit``, all quantities must have the same unit. Raises RecordingError if there is no such body or
    quantity, or the units differ.
    """
    asked: dict[tuple[int, Quantity], None] = {}
    with_commas = [body for body in recording.bodies.name if "," in body]
    for part in split_at_commas(text, (f"{body}.{name}" for body in with_commas for name in QUANTITIES)):
        body, _, name = part.rpartition(".")
        if not body:
            raise RecordingError(f'plot {text}: expected BODY.QUANTITY, such as 0.speed; "{part}" is not')
        if name not in QUANTITIES:
            raise RecordingError(f'plot {text}: there is no quantity "{name}"; there are {_all_quantities()}')
        asked[body_number(recording, body), QUANTITIES[name]] = None
    if any(quantity.vector == "angular_velocity" for _, quantity in asked) and not recording.info["spins"]:
        raise RecordingError(f"plot {text}: the bodies of {recording.path} do not spin")
    if len(asked) > MOST:
        raise RecordingError(f"plot: {len(asked)} curves are more than {MOST}; request fewer")
    units = dict.fromkeys(quantity.unit for _, quantity in asked)
    if one_unit and len(units) > 1:
        raise RecordingError(
            f"a view of plots shows one unit, but plot requests {' and '.join(units)}; request quantities of one "
            'unit, or use the view "all", which has a separate plot for each unit'
        )
    return list(asked)


def needs_replay(asked: Sequence[tuple[int, Quantity]]) -> bool:
    """Return whether the run must be repeated: positions are recorded at every frame, velocities are not."""
    return any(quantity.vector != "position" for _, quantity in asked)


def body_series(
    recording: Recording, asked: Sequence[tuple[int, Quantity]], watch: Callable[[StepStatus], None] = lambda _: None
) -> list[BodySeries]:
    """Return the requested series; ``watch`` is called after every frame if the run is repeated.

    Raises RecordingError if the run must be repeated and cannot be, or its bits differ.
    """
    bodies = sorted({body for body, _ in asked})
    read = _replayed(recording, bodies, watch) if needs_replay(asked) else _recorded(recording, bodies)
    names = recording.bodies.name
    return [
        BodySeries(body, names[body] or body_called(body, ""), quantity, step, time, quantity.of(vectors))
        for body, quantity in asked
        for step, time, vectors in [read(body, quantity.vector)]
    ]


_Read = Callable[[int, str], tuple[IntArray, FloatArray, FloatArray]]  # body, vector → steps, times, (k, 3)


def _recorded(recording: Recording, bodies: Sequence[int]) -> _Read:
    tables = {body: recording.trajectory(body) for body in bodies}

    def read(body: int, vector: str) -> tuple[IntArray, FloatArray, FloatArray]:
        table = tables[body]
        position = np.stack([np.asarray(table[axis].to_numpy()) for axis in "xyz"], axis=1)
        return table[STEP].to_numpy(), table["time"].to_numpy(), position

    return read


def _replayed(recording: Recording, bodies: Sequence[int], watch: Callable[[StepStatus], None]) -> _Read:
    frames = recording.fingerprints()
    steps, times = frames[STEP].to_numpy(), frames["time"].to_numpy()
    window, wanted = Window(recording, float(times[0]), watch=watch), set(steps.tolist())
    found: dict[str, list[FloatArray]] = {vector: [] for vector, *_ in _VECTORS}
    for frame in window.frames(np.inf):
        if frame.step in wanted:
            for vector, rows in found.items():
                values = getattr(frame, vector)
                if values is not None and len(values):
                    rows.append(values[bodies])
        if frame.step >= steps[-1] or window.differs is not None:
            break
    if window.differs is not None or len(found["position"]) < len(steps):
        where = "ends earlier" if window.differs is None else f"differs in its bits from step {window.differs} on"
        raise RecordingError(f"the repeated run of {recording.path} {where}; only positions (x, y, z) can be plotted")
    stacked = {vector: np.stack(rows) for vector, rows in found.items() if rows}
    return lambda body, vector: (steps, times, stacked[vector][:, bodies.index(body)])


def _all_quantities() -> str:
    """List the quantities by their units."""
    groups = [
        f"{', '.join(quantity.name for quantity in QUANTITIES.values() if quantity.unit == unit)} ({unit})"
        for _, unit, *_ in _VECTORS
    ]
    return f"{', '.join(groups[:-1])} and {groups[-1]}"


TITLES = {"m": "Position", "m/s": "Velocity", "rad/s": "Spin"}


@dataclass(frozen=True, slots=True)
class BodyPlots:
    """The series to plot."""

    series: Sequence[BodySeries]
    system: UnitSystem = SI  # units of the recording
    colours: Mapping[int, int] = field(default_factory=dict)  # colours of the bodies, if they are constant in time
    alone: bool = False  # whether a plot fills the picture
    caption: Sequence[str] = ()  # title of a plot that fills the picture: lines of the legend
    span: IntArray | None = None  # (2,) ns, ends of the time axis of a picture

    @property
    def units(self) -> list[str]:
        """The units of the plots, from left to right."""
        return [unit for unit in TITLES if any(each.quantity.unit == unit for each in self.series)]

    def rows(self) -> Iterator[Rows]:
        """Yield the values."""
        for each in self.series:
            columns = rr.Scalars.columns(scalars=self._shown(each))
            yield Rows(_path(each), Index(each.step, each.time), columns)

    def statics(self) -> Iterator[tuple[str, rr.AsComponents]]:
        """Yield the styles of the curves."""
        for unit in self.units:
            series = self._of(unit)
            for each, colour in zip(series, self._curve_colours(series), strict=True):
                yield _path(each), curve_style(self._legend(each), colour)

    def _curve_colours(self, series: Sequence[BodySeries]) -> list[int]:
        """Return the colours of the curves of a plot: each has its body's colour, if that distinguishes the curves.

        If a body has two curves, or two bodies have similar colours, each curve gets another colour.
        """
        own = palette.legible(self.colours.get(each.body, 0) for each in series).tolist()
        lines = list(palette.LINES.values())
        known = all(each.body in self.colours for each in series)
        return own if known and len(set(own)) == len(own) else [lines[k % len(lines)] for k in range(len(series))]

    def views(self, row: Area) -> list[rrb.View]:
        """Lay out a plot for each unit, side by side in a row."""
        area = Area(row.width / max(1, len(self.units)), row.height)
        return [self.view(unit, area) for unit in self.units]

    def view(self, unit: str, area: Area) -> rrb.View:
        """Lay out the plot of a unit."""
        series = self._of(unit)
        legends = [self._legend(each) for each in series]
        title = _named(series[0]) if len(series) == 1 else TITLES[unit]
        curves = [CurveOutline.of(each.time, self._shown(each)) for each in series]
        return time_series_view(
            self._titled(title, unit),
            [_path(each) for each in series],
            legends if self.alone or len(legends) > 1 else [],
            curves,
            area,
            span=self.span,
            caption=self.caption,
        )

    def _legend(self, series: BodySeries) -> str:
        return self._titled(_named(series), series.quantity.unit) if self.alone else _named(series)

    def _titled(self, title: str, unit: str) -> str:
        """Return a title with the scene's unit for an SI unit."""
        return self.system.labelled(title, OF_UNIT[unit])

    def _shown(self, series: BodySeries) -> FloatArray:
        """Return the values in the scene's unit."""
        return series.value / self.system.factor(OF_UNIT[series.quantity.unit])

    def _of(self, unit: str) -> list[BodySeries]:
        return [each for each in self.series if each.quantity.unit == unit]


def _path(series: BodySeries) -> str:
    return f"plot/body{series.body}/{series.quantity.name}"


def _named(series: BodySeries) -> str:
    return f"{series.name} {series.quantity.name}"
