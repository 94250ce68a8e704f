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
from carom.display.legend import LegendContents, drawn_during, impact_marks, legend
from carom.display.legend_layout import MovieClock
from carom.display.letters import drawable
from carom.display.margins import margins
from carom.display.motion_marks import motion_marks
from carom.display.picture import headless, stable_picture, window_of
from carom.display.presentation import asked, uniform_field
from carom.display.request import Request
from carom.display.staging import Staging, caption, decades, impact_strip, names_that_fit, whole_span
from carom.display.supplement import Supplement
from carom.display.viewer import Viewer
from carom.errors import RecordingError
from carom.recording.layout import (
    ALL,
    CLOSE_UP,
    as_happened,
    blueprint,
)
from carom.recording.layout.camera import FEW
from carom.recording.layout.canvas import Additions, CameraMotion, Canvas
from carom.recording.read.frame_rows import RecordedPositions
from carom.recording.read.recorded_scene import header_of_recording, recorded_curves
from carom.recording.read.recording import Recording
from carom.recording.schema.header import TimeScale, viewer_time
from carom.recording.timelines import STEP
from carom.recording.write.static_entities import arrow_styles
from carom.scene.units.dimension import TIME

FORMATS = (".mp4", ".gif")

_MOST_VIEWERS = 4
_FRAMES_EACH = 20  # number of pictures that justify another viewer, whose start takes seconds
_LOOKS = 50  # number of frames that are searched for a free corner for the legend
_PICTURES_EACH = 4  # smallest number of pictures for each impact around which a movie is slow
_SLOW_EACH, _MOST_SLOW = 0.05, 0.5  # largest fractions of a movie, around each impact and around all impacts
_AROUND = 0.02  # largest fraction of the shown time that is slow before and after an impact
_PACE = 4  # a picture's pace is measured from this number of pictures before it and after it
_SLOW = 2.0  # the clock says how slow a part of a movie is if it is this many times slower than the fastest part
_MOST_DIGITS = 9  # largest number of digits after the decimal point
_LIMIT = 60.0  # s, time limit for a picture to settle


def frame_times(
    recording: Recording, start: float | None, end: float | None, count: int, *, slowed: bool = False
) -> FloatArray:
    """Return the times (s) of recorded frames for ``count`` pictures from start to end (s).

    The pictures are equally spaced in time or, if ``slowed``, closer together around the hardest impacts. The exact
    times of impacts are among the times. Raises RecordingError if there are fewer than two frames, or the interval is
    not in the recording.
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
    impacts = _hardest(recording, start, end, count // _PICTURES_EACH) if slowed else np.zeros(0)
    if len(impacts):
        share = np.linspace(0.0, 1.0, count)
        wanted = _around(impacts, start, end, share)
        times = np.union1d(times, impacts)
    rows = np.searchsorted(times, wanted * (1.0 + 1e-12), side="right") - 1
    shown = np.asarray(times[np.maximum(rows, 0)])
    shown[np.minimum(np.searchsorted(wanted, impacts), count - 1)] = impacts  # each instant has a picture
    return shown


def _hardest(recording: Recording, start: float, end: float, most: int) -> FloatArray:
    """Return the instants (s) of the ``most`` hardest recorded impacts between start and end."""
    if not header_of_recording(recording).records_contacts:
        return np.zeros(0)
    table = recording.impacts(start, end)
    times, impulses = table["time"].to_numpy(), np.nan_to_num(table["normal_impulse"].to_numpy())
    inside = (times > start) & (times < end)
    instants, which = np.unique(times[inside], return_inverse=True)
    largest = np.zeros(len(instants))
    np.maximum.at(largest, which, impulses[inside])
    return np.asarray(np.sort(instants[np.argsort(-largest, kind="stable")[:most]]))


def _around(impacts: FloatArray, start: float, end: float, share: FloatArray) -> FloatArray:
    """Return the times (s) shown after fractions ``share`` of a movie, which is slow around ``impacts`` (s).

    A part of the movie covers the time evenly. The rest covers an interval around each impact; intervals end halfway
    between two impacts.
    """
    borders = np.concatenate([[start], impacts, [end]])
    half = np.minimum(0.5 * np.diff(borders), _AROUND * (end - start))
    first, last = impacts - half[:-1], impacts + half[1:]
    slow = min(_MOST_SLOW, _SLOW_EACH * len(impacts))
    known = np.unique(np.concatenate([[start, end], first, last]))
    over = np.interp(known, np.ravel([first, last], "F"), np.repeat(np.arange(len(impacts) + 1.0), 2)[1:-1])
    over = (1.0 - slow) * (known - start) / (end - start) + slow * over / len(impacts)
    return np.asarray(np.interp(share, over, known))


def clock_of(recording: Recording, times: FloatArray) -> MovieClock:
    """Return the texts of a movie's clock, given the times (s) of its pictures: the time, and how slowly it passes."""
    shown, first = np.unique(times, return_index=True)
    units = recording.units
    apart = units.shown(float(np.diff(shown).min(initial=np.ptp(shown))), TIME) or 1.0
    digits = int(np.clip(np.ceil(-np.log10(apart)), 0, _MOST_DIGITS))
    window = np.clip(np.add.outer([-_PACE, _PACE], np.arange(len(times))), 0, len(times) - 1)
    pace = np.diff(times[window], axis=0)[0] / np.diff(window, axis=0)[0].clip(1)
    texts = list[str]()
    for moment, row in zip(shown.tolist(), first.tolist(), strict=True):
        text = f"t = {units.text(moment, TIME, f'.{digits}f')}"
        slower = float(pace.max() / pace[row]) if pace[row] > 0.0 else 1.0
        texts.append(f"{text}, slow motion 1 : {float(f'{slower:.1g}'):g}" if slower >= _SLOW else text)
    return MovieClock(shown, texts)


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
    """Return a PNG for each time, in order; each is rendered when it is requested.

    Each picture comes from a viewer that has settled: two successive pictures are equal, byte for byte. Several viewers
    share the work, because each uses one core.

    Parameters
    ----------
    times
        s, ascending; equal times give the same picture.
    size
        Width and height in pixels.
    view
        The view that fills the picture, or all views.
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
        clock = clock_of(recording, times)
        supplement = asked(recording, Request(event=event, bodies=bodies), canvas, view, clock=clock).supplement
    elif not recording.is_overlay:
        canvas = Canvas(*size, framed=view == ALL, rendered=True, theme=theme)
        supplement = _layout(recording, different, canvas, view, camera, clock_of(recording, times))
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
        # at the end, the viewer is closed first, so that a thread waiting for a picture fails at once
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
    recording: Recording,
    times: Sequence[float],
    canvas: Canvas,
    view: str,
    motion: CameraMotion | None = None,
    clock: MovieClock | None = None,
) -> Supplement:
    """Lay out the views with a camera fitted to the bodies at all times and, in the light theme, legible colours."""
    header, recorded = header_of_recording(recording), RecordedPositions(recording)
    table = recording.fingerprints()
    rows = np.maximum(np.searchsorted(table["time"].to_numpy(), times, side="right") - 1, 0)
    positions = [recorded.drawn(int(step)) - recording.origin for step in table[STEP].to_numpy()[rows]]
    middling = np.argsort([_extent(position) for position in positions])[len(positions) // 2]
    colours = trail_colours(recording, header, header.coloured_by, canvas.theme)
    staging = Staging.of(recording, header, positions[int(middling)], colours, motion=motion)
    staging.camera.show_all()
    recoloured = redrawn_for(header, canvas.theme)
    scale, curves = TimeScale(float(recording.info["time_scale"])), recorded_curves(recording)
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
    note = viewer_time(header.units, scale)
    contents |= LegendContents(trails=staging.trails is not None)
    words = legend(
        *(laid_out, by, fixed, references, None, contents),
        viewer_time=note,
        field=field,
        recent=staging.recent,
        theme=theme,
    )
    words = words.titled(header.title, clock or clock_of(recording, np.array(times)))
    added = Additions(
        trails=staging.trails is not None,
        recent=staging.recent_of(scale),
        recoloured=recoloured,
        legend=words,
        struck=bool(strip),
        decades=logarithms,
        span=scale.nanoseconds(whole_span(recording)),
        marks=marks,
        viewer_time=note,
    )
    some = np.concatenate(positions[:: max(1, len(positions) // _LOOKS)])
    radius = np.resize(header.radius, len(some))
    if view == "energy" and drawable(header.title):
        ((row, static),) = caption([header.title], theme, float(times[0]))
        strip, bands, added = [*strip, row], [*bands, static], replace(added, caption=[header.title])
    parts = (laid_out, staging.camera, canvas, view, added, words, field, some, radius)
    placed = margins(*parts, poses=lambda eye: staging.poses(eye, positions), times=np.array(times))
    statics = [*bands, *styles, *staging.statics(theme), *arrow_styles(header, theme), *placed.statics]
    statics += motion_marks(header, recording.origin, placed.view, placed.area, float(times[0]))
    named = names_that_fit(header, positions[int(middling)], placed.view, placed.area)
    layout = blueprint(header, staging.camera, curves, canvas, view, replace(placed.added, named=named))
    drawn = [
        *strip,
        *drawn_logarithms,
        *staging.rows(),
        *placed.rows,
        *staging.camera_rows(layout, np.array(times), positions),
    ]
    if recoloured and bodies is not None:
        drawn.append(bodies.rows(header))
    return Supplement(layout, scale, drawn, statics)


def _extent(position: FloatArray) -> float:
    """Return the median distance (m) from the middle; a few distant bodies do not change the median."""
    return float(np.median(np.linalg.norm(position - np.median(position, axis=0), axis=1)))
