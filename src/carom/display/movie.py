"""The pictures of a movie: a recording at many times."""

from __future__ import annotations

import os
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import replace
from itertools import cycle

import numpy as np

from carom.arrays import FloatArray
from carom.display.body_colours import body_colours, change_with_time, redrawn_for, trail_colours
from carom.display.legend import GRAPH, LegendContents, drawn_during, impact_marks, legend
from carom.display.picture import headless, stable_picture, window_of
from carom.display.presentation import asked, uniform_field
from carom.display.request import Request
from carom.display.staging import Staging, axes_and_field, decades, impact_strip, whole_span
from carom.display.supplement import Supplement
from carom.display.viewer import Viewer
from carom.errors import RecordingError
from carom.recording.layout import (
    ALL,
    CLOSE_UP,
    as_happened,
    blueprint,
    bodies_area,
    bodies_eye,
    graph_eye,
    legend_area,
)
from carom.recording.layout.camera import FEW
from carom.recording.layout.canvas import CORNERS, Additions, CameraMotion, Canvas, free_corner
from carom.recording.read.frame_rows import RecordedPositions
from carom.recording.read.recorded_scene import header_of_recording, recorded_curves
from carom.recording.read.recording import Recording
from carom.recording.schema.header import TimeScale, viewer_time
from carom.recording.schema.paths import STEP
from carom.recording.write.static_entities import arrow_styles
from carom.scene.units.dimension import TIME

FORMATS = (".mp4", ".gif")

_MOST_VIEWERS = 4
_FRAMES_EACH = 20  # pictures for which it pays to start another viewer, which takes seconds
_LOOKS = 50  # frames among which a legend finds a free corner
_LIMIT = 60.0  # s, in which a picture must settle


def frame_times(recording: Recording, start: float | None, end: float | None, count: int) -> FloatArray:
    """Return the times (s) of recorded frames for ``count`` pictures, equally spaced from start to end (s).

    Raises RecordingError if there are fewer than two frames, or the interval is not in the recording.
    """
    times = recording.fingerprints()["time"].to_numpy()
    if len(times) < 2:
        raise RecordingError(
            f"{recording.path} has {len(times)} frames, too few for a movie; `carom picture` renders a single frame"
        )
    start, end = float(times[0]) if start is None else start, float(times[-1]) if end is None else end
    recording.moment(start)
    recording.moment(end)
    if not start < end:
        first, last = (recording.units.text(time, TIME, ".9g") for time in (start, end))
        raise RecordingError(f"from {first} to {last}: a movie goes from an earlier time to a later one")
    wanted = np.linspace(start, end, count)
    rows = np.searchsorted(times, wanted * (1.0 + 1e-12), side="right") - 1
    return np.asarray(times[np.maximum(rows, 0)])


def pictures(
    recording: Recording,
    times: FloatArray,
    size: tuple[int, int],
    view: str = ALL,
    *,
    theme: str = "dark",
    event: str | None = None,
    bodies: str | None = None,
    camera: CameraMotion | None = None,
) -> Iterator[bytes]:
    """Return a PNG for each time, in order; they are rendered as they are requested.

    Each is rendered by a viewer that has settled: two successive pictures are equal, byte for byte. Several viewers
    share the work, because each uses one core.

    Parameters
    ----------
    times
        s, ascending; equal times give the same picture.
    size
        Width and height in pixels.
    view
        The view that fills the picture, or all of them.
    event, bodies
        What a close-up follows, as in `Request`; by default the bodies of the hardest impact.
    camera
        How the camera of the other views moves; by default it depends on the scene.

    Raises
    ------
    RecordingError
        If there is no Vulkan driver, a viewer ends, or the recording has nothing to show in the view.
    """
    different = list(dict.fromkeys(times.tolist()))
    supplement = None
    if view == CLOSE_UP:
        canvas = Canvas(*size, framed=False, rendered=True, theme=theme)
        supplement = asked(recording, Request(event=event, bodies=bodies), canvas, view).supplement
    elif not recording.is_overlay:
        canvas = Canvas(*size, framed=view == ALL, rendered=True, theme=theme)
        supplement = _layout(recording, different, canvas, view, camera)
    return _taken(times, lambda stack: _Studio(stack, recording, supplement, size, view, theme))


def _taken(times: FloatArray, studio: Callable[[ExitStack], _Studio]) -> Iterator[bytes]:
    """Take the pictures, with another studio for every `_FRAMES_EACH` of them."""
    different = list(dict.fromkeys(times.tolist()))
    count = max(1, min(_MOST_VIEWERS, os.cpu_count() or 1, len(different) // _FRAMES_EACH))
    with ExitStack() as stack:
        studios = [studio(stack) for _ in range(count)]
        waiting: deque[Future[bytes]] = deque()
        ahead = zip(different, cycle(studios), strict=False)
        last, png = np.nan, b""
        for moment in times:
            while len(waiting) <= 2 * count and (following := next(ahead, None)):
                waiting.append(following[1].take(following[0]))
            if moment != last:
                last, png = moment, waiting.popleft().result()
            yield png


class _Studio:
    """A viewer, and the thread that takes its pictures."""

    def __init__(
        self,
        stack: ExitStack,
        recording: Recording,
        supplement: Supplement | None,
        size: tuple[int, int],
        view: str,
        theme: str,
    ) -> None:
        self._recording = recording
        self._whole = view == ALL or recording.is_overlay
        self._supplement = supplement
        self._view: str | None = None
        self._started = False
        self._thread = stack.enter_context(ThreadPoolExecutor(1))
        # at the end, the viewer is closed first, so that a thread that waits for a picture fails at once
        self._viewer: Viewer = stack.enter_context(headless(recording, window_of(size, self._whole), theme))
        stack.callback(self._thread.shutdown, wait=False, cancel_futures=True)

    def take(self, at: float) -> Future[bytes]:
        """Request a picture at a time (s)."""
        return self._thread.submit(self._take, at)

    def _take(self, at: float) -> bytes:
        if self._started:
            self._viewer.go_to(self._recording, at)
            return self._picture()
        self._viewer.show(self._recording)
        self._viewer.go_to(self._recording, at)
        if self._supplement is not None:
            self._viewer.add(self._supplement)
        self._view = None if self._whole else self._viewer.only_view()
        self._started = True
        self._viewer.outlast_note()
        stable_picture(self._viewer, self._view)
        return self._picture()

    def _picture(self) -> bytes:
        """Render until two successive pictures are equal: the list of events scrolls one picture after bodies move."""
        last, end = b"", time.monotonic() + _LIMIT
        while (png := self._viewer.screenshot(self._view)) != last:
            last = png
            if time.monotonic() > end:
                raise RecordingError(f"the viewer's picture did not settle within {_LIMIT:.0f} s")
        return png


def _layout(
    recording: Recording, times: Sequence[float], canvas: Canvas, view: str, motion: CameraMotion | None = None
) -> Supplement:
    """Lay out the views with a camera fitted to the bodies at all times and, in the light theme, legible colours."""
    header, recorded = header_of_recording(recording), RecordedPositions(recording)
    table = recording.fingerprints()
    rows = np.searchsorted(table["time"].to_numpy(), times)
    steps, moments = table[STEP].to_numpy()[rows], table["time"].to_numpy()[rows]
    positions = [recorded.drawn(int(step)) - recording.origin for step in steps]
    middling = np.argsort([_extent(position) for position in positions])[len(positions) // 2]
    colours = trail_colours(recording, header, header.coloured_by, canvas.theme)
    staging = Staging.of(recording, header, positions[int(middling)], colours, motion=motion)
    staging.camera.show_all()
    recoloured = redrawn_for(header, canvas.theme)
    clock, curves = TimeScale(float(recording.info["time_scale"])), recorded_curves(recording)
    impulses, strip, bands = impact_strip(recording)
    curves |= impulses
    logarithms, drawn_logarithms, styles = decades(recording, header, curves)
    by, theme = header.coloured_by, canvas.theme
    bodies = None
    if recoloured or not change_with_time(header, by):
        bodies = body_colours(recording, header, by).on(theme)
    laid_out, field = as_happened(header, curves), uniform_field(recording, header)
    marks = impact_marks(recording, header) if header.bodies <= FEW else np.zeros((0, 3))
    contents = drawn_during(recording, laid_out)
    references = {name: float(value) for name, value in recording.arrow_references.items()}
    fixed = None if bodies is None else bodies.fixed
    note = viewer_time(header.units, clock)
    contents |= LegendContents(trails=staging.trails is not None)
    words = legend(*(laid_out, by, fixed, references, None, contents), viewer_time=note, field=field, theme=theme)
    added = Additions(
        trails=staging.trails is not None,
        recoloured=recoloured,
        legend=words,
        struck=bool(strip),
        decades=logarithms,
        span=clock.nanoseconds(whole_span(recording)),
        marks=marks,
        viewer_time=note,
    )
    area = bodies_area(laid_out, canvas, view, close=False)
    statics = [*bands, *styles, *staging.statics(), *arrow_styles(header, theme)]
    seen = bodies_eye(staging.camera, area, added)
    if view == ALL:
        statics += words.statics(legend_area(canvas))
    if seen.motion is CameraMotion.STILL:  # with a moving camera, nothing stays in a corner
        added = replace(added, inset=words.of(view).size)
        area = replace(area, inset=added.inset)
        seen = bodies_eye(staging.camera, area, added)
        if view == GRAPH:
            seen = graph_eye(header, staging.camera, area, added)
        some = np.concatenate(positions[:: max(1, len(positions) // _LOOKS)])
        radius = np.resize(header.radius, len(some))
        corner = free_corner(seen, area.aspect, area.inset_share, some, radius) or CORNERS[0]
        statics += words.of(view).inside(seen, area, corner)
        statics += axes_and_field(header, seen, area, field, some, radius, corner if added.inset[0] else None)
        added = replace(added, axes=True)
    layout = blueprint(header, staging.camera, curves, canvas, view, added)
    drawn = [*strip, *drawn_logarithms, *staging.rows(), *staging.camera_rows(layout, steps, moments, positions)]
    if recoloured and bodies is not None:
        drawn.append(bodies.rows(header))
    return Supplement(layout, clock, drawn, statics)


def _extent(position: FloatArray) -> float:
    """Return the median distance (m) from the middle, which a few distant bodies do not change."""
    return float(np.median(np.linalg.norm(position - np.median(position, axis=0), axis=1)))
