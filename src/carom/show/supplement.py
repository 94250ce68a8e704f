"""`Supplement`: rows and a layout that a viewer gets in addition to a recording; the file does not change.

Among them are trails, the paths of a few bodies up to the moment that is shown.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from carom.arrays import ColourArray, FloatArray, SingleArray
from carom.recording.layout import TRAILS
from carom.recording.layout.camera import FEW, CameraFit
from carom.recording.read.frame_rows import drawn_paths
from carom.recording.read.recording import Recording
from carom.recording.schema.header import Header, TimeScale
from carom.recording.schema.paths import STEP
from carom.recording.write.durable_sink import FLUSH
from carom.recording.write.rerun_compat import send_layout
from carom.recording.write.rows import Index, Rows

Static = tuple[str, rr.AsComponents]


@dataclass(frozen=True, slots=True)
class Supplement:
    """Rows, static data and a layout, sent to a viewer that shows the recording."""

    layout: rrb.Blueprint
    clock: TimeScale  # of the recording
    rows: Sequence[Rows] = ()
    statics: Sequence[Static] = ()

    def send(self, address: str, application: str, recording_id: str) -> None:
        """Send it to the recording of these ids in the viewer at an address."""
        self._put(rr.GrpcSink(address), application, recording_id)

    def save(self, path: Path, application: str, recording_id: str) -> None:
        """Write it to a file, which a viewer loads in addition to the recording of these ids."""
        self._put(rr.FileSink(path), application, recording_id)

    def _put(self, sink: rr.GrpcSink | rr.FileSink, application: str, recording_id: str) -> None:
        with rr.RecordingStream(application, recording_id=recording_id, send_properties=False) as stream:
            stream.set_sinks(sink)
            for path, archetype in self.statics:
                stream.log(path, archetype, static=True)
            for rows in self.rows:
                stream.send_columns(rows.path, self.clock.columns(*rows.index), rows.columns)
            send_layout(stream, application, self.layout)
            stream.flush(timeout_sec=FLUSH)
            stream.disconnect()


_MOST_FRAMES = 2000  # of longer paths, every k-th frame is used
# points of a path drawn as a curve through fewer frames, since integrators of high order take long steps
_POINTS = 1000


class Trails:
    """The paths of all bodies of a recording, as pieces from frame to frame.

    Where nothing ever touched, a piece is part of the cubic spline through all frames. ``colours`` (n,) are those of
    the bodies.
    """

    def __init__(self, recording: Recording, header: Header, colours: ColourArray) -> None:
        drawn = drawn_paths(recording, range(len(header.radius)))
        table = recording.fingerprints()
        rows = np.minimum(np.searchsorted(table[STEP].to_numpy(), drawn.steps), table.num_rows - 1)
        every = -(-len(drawn.steps) // _MOST_FRAMES)
        self._steps = drawn.steps[::every]
        self._times = table["time"].to_numpy()[rows][::every]
        self._position = drawn.position[::every]
        self._box, self._shear = header.box, header.shear
        untouched = recording.closing.get("contacts.total") == 0 and header.box is None
        self._is_smooth = untouched and bool((np.diff(self._times) > 0.0).all())
        self._colours = colours

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
        yield Rows(TRAILS, Index(self._steps[1:], self._times[1:]), columns, strips.nbytes)

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
