"""`FrameRecorder`: writes frames of the physics to an .rrd in a separate thread, with occasional checkpoints."""

from __future__ import annotations

import threading
import time
from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Generic, Self, TypeVar

import numpy as np

from carom.arrays import FloatArray
from carom.errors import RecorderError, RecordingError, status_of
from carom.event import Event
from carom.physics.bodies import Bodies
from carom.physics.frame_store import FrameStore
from carom.recording.layout import blueprint
from carom.recording.layout.camera import CameraFit
from carom.recording.layout.canvas import Additions
from carom.recording.read.frame_rows import Continuation
from carom.recording.read.recorded_impacts import RecordedImpacts
from carom.recording.read.recorded_scene import recorded_curves
from carom.recording.read.recording import Recording
from carom.recording.schema.checkpoint_columns import BOOKS_BYTES, size
from carom.recording.schema.header import Header, Scalar, TimeScale, viewer_time
from carom.recording.write.durable_sink import AddressReserve
from carom.recording.write.encoder import BatchEncoder
from carom.recording.write.impact_plan import DRAWN_BYTES, TURNED_BYTES
from carom.recording.write.partial_frames import Lives
from carom.recording.write.rows import event_rows
from carom.recording.write.stream import BATCH_BYTES, Stream, frames_in_batch
from carom.recording.write.whole_file import new_file
from carom.state.frame import Frame

# A bounded queue from the physics thread to the recorder, read in batches. The reader sleeps until a batch is full or
# due. `queue.Queue` would wake the reader for every frame, and the reader would take the interpreter lock from the
# physics. Waiting for the lock costs a tenth of the time of a run with 1000 bodies (benchmarks/recording.py).

_Item = TypeVar("_Item")


class BatchQueue(Generic[_Item]):
    """Holds at most ``capacity`` items. `take` returns ``batch`` items, or all available items after ``seconds``."""

    def __init__(self, capacity: int, batch: int, seconds: float) -> None:
        self._capacity = max(capacity, batch)
        self._batch = batch
        self._seconds = seconds
        self._items: list[_Item] = []
        self._changed = threading.Condition()
        self._oldest = 0.0  # monotonic time (s) at which the oldest item was added
        self._closed = False
        self._error: Exception | None = None

    def wait_for_room(self) -> None:
        """Wait while the queue is full; return at once after `fail`. Only the thread that puts items may call it."""
        if len(self._items) < self._capacity:  # no other thread adds items
            return
        with self._changed:
            self._changed.wait_for(lambda: self._error is not None or len(self._items) < self._capacity)

    def put(self, item: _Item) -> None:
        """Add an item; wait while the queue is full. Raises the error given to `fail`, if any."""
        with self._changed:
            self._changed.wait_for(lambda: self._error is not None or len(self._items) < self._capacity)
            if self._error is not None:
                raise self._error
            if not self._items:
                self._oldest = time.monotonic()
            self._items.append(item)
            # the first item of a batch starts the reader's clock, the last item completes the batch
            if len(self._items) in (1, self._batch):
                self._changed.notify_all()

    def close(self) -> None:
        """Close the queue: after the remaining items, `take` returns an empty batch."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()

    def fail(self, error: Exception) -> None:
        """Make every later `put` raise this error, because the reader has stopped."""
        with self._changed:
            self._error = error
            self._changed.notify_all()

    def take(self, within: float | None = None) -> list[_Item] | None:
        """Wait for a batch. An empty batch means that the queue is closed, None that no item came in time (s)."""
        with self._changed:
            latest = None if within is None else time.monotonic() + within
            while not self._closed and len(self._items) < self._batch:
                due = self._oldest + self._seconds if self._items else latest
                left = None if due is None else due - time.monotonic()
                if left is not None and left <= 0.0:
                    if not self._items:
                        return None
                    break
                self._changed.wait(left)
            taken, self._items = self._items[: self._batch], self._items[self._batch :]
            self._oldest = time.monotonic()
            self._changed.notify_all()
            return taken


class CheckpointPlan:
    """Decides which frames carry a checkpoint, so that checkpoints take about a tenth of the recording.

    The first frame always carries a checkpoint. The frame before a warning carries a checkpoint, too, until such
    checkpoints have used another tenth. The choice depends on the frames but not on the batches, so that the same run
    always has the same checkpoints.
    """

    _SHARE = 0.1
    _EDGE_BYTES = 28  # bytes of a contact: two bodies, impulses, mode, colour and width
    _SCALAR_BYTES = 20 * 24  # bytes of twenty scalars, each with its times
    _WARNINGS_AT_LEAST = 4

    def __init__(self, every_frame: bool = False, steps: Collection[int] | None = None) -> None:
        self._every_frame = every_frame  # whether every frame carries a checkpoint, as in runs that cannot be repeated
        self._steps = steps  # steps of the frames with a checkpoint, if these are known in advance
        self._others = 0  # bytes of all frames so far, without checkpoints
        self._regular = 0  # bytes of checkpoints other than those before warnings
        self._warned = 0
        self._warnings = 0
        self._before: Frame | None = None
        self._last_kept = -1

    def chosen(self, batch: Sequence[Frame]) -> list[Frame]:
        """Return the frames of a batch that carry a checkpoint; the first may be the last frame of the last batch."""
        if self._every_frame or self._steps is not None:
            return [frame for frame in batch if self._steps is None or frame.step in self._steps]
        kept: list[Frame] = []
        for frame in batch:
            # approximate bytes of the frame's rows without arrows: drawn bodies and contacts, and twenty scalars
            drawn = len(frame.position) * (DRAWN_BYTES if frame.orientation is None else TURNED_BYTES)
            self._others += drawn + self._EDGE_BYTES * len(frame.contacts) + self._SCALAR_BYTES
            room = self._SHARE * self._others
            before, self._before = self._before, frame
            warns = any(event.level == "WARN" for event in frame.events)
            if warns and before and before.step != self._last_kept:
                warned = self._warned + size(before)
                if self._warnings < self._WARNINGS_AT_LEAST or warned <= room:
                    self._warnings, self._warned, self._last_kept = self._warnings + 1, warned, before.step
                    kept.append(before)
            if self._last_kept >= 0 and room < self._regular + BOOKS_BYTES:
                # skip the rest for most frames of few bodies, since counting the other bytes takes 15 µs
                continue
            cost = size(frame)
            if self._last_kept < 0 or self._regular + cost <= room:
                self._regular += cost
                kept.append(frame)
                self._last_kept = frame.step
        return kept


_BATCH_FRAMES, _QUEUE_FRAMES = 2048, 512
# largest batch; small frames are joined since a chunk costs 2.4 kB, as much as 40 scalars
_SMALL_FRAMES, _SMALL_BYTES = 4096, 16_000_000
_BATCH_SECONDS, _LIVE_SECONDS = 2.0, 1.0  # s of frames that a killed run may lose, and by which a live viewer lags
_QUEUE_BYTES = 64_000_000
_BODY_BYTES, _FRAME_BYTES = 300, 2000  # bytes, largest memory of a waiting frame: per body, and for the rest
_LOOK = 1.25  # ratio between the frame counts at two updates of the camera
# bytes; smaller or shorter recordings get a blueprint only at the end, since it takes 10 ms
_LAID_OUT_AFTER = 1_000_000


def waiting_frames(bodies: int, queue_size: int | None = None) -> tuple[int, int, int]:
    """Return the largest numbers of frames in the queue of a recording, in a batch, and in memory."""
    frame_bytes = _BODY_BYTES * bodies + _FRAME_BYTES
    small = min(_SMALL_FRAMES, _SMALL_BYTES // frame_bytes)
    room = queue_size or max(1, min(_QUEUE_FRAMES, _QUEUE_BYTES // frame_bytes), small)
    batch = max(1, min(_BATCH_FRAMES, frames_in_batch(bodies), room // 2))
    # the memory of a frame is reused once it has left the queue, the batch being written, and `_last`; a frame being
    # copied already has a place in the queue
    return room, batch, max(room, batch) + batch + 1


class FrameRecorder:
    """Writes one recording.

    ``put`` only enqueues, and blocks while the queue is full: no frame is dropped. The first error, such as a full
    disk, closes the file if that is possible, and is raised by the next ``put`` and by ``finish``.
    """

    def __init__(
        self,
        path: str | Path,
        header: Header,
        *,
        live: str | None = None,
        queue_size: int | None = None,
        continued: Continuation | None = None,
        # steps that carry a checkpoint; by default `CheckpointPlan` chooses them
        checkpoints: Collection[int] | None = None,
    ) -> None:
        self.path = Path(path)
        self._file = new_file(self.path)  # an earlier recording is replaced once this one is complete
        self._opened = time.monotonic()
        self.header = header
        self.frames = 0  # number of frames sent so far
        self.bodies = header.bodies  # number of bodies so far, in runs in which bodies enter
        self._extended: dict[int, Header] = {}  # headers with more bodies, by the number of bodies
        self._lives = Lives(header.bodies)
        self._continued = continued
        frame_bytes = _BODY_BYTES * header.bodies + _FRAME_BYTES
        self._stream = Stream(self.path, header, file=self._file, batch_bytes=max(BATCH_BYTES, frame_bytes), live=live)
        self._clock = continued.clock if continued else TimeScale.fitting(header.duration, header.shortest_dt_hint)
        room, batch, self._slots = waiting_frames(header.bodies, queue_size)
        self._queue: BatchQueue[Frame] = BatchQueue(room, batch, _BATCH_SECONDS if live is None else _LIVE_SECONDS)
        self._store: FrameStore | None = None
        self._plan = CheckpointPlan(every_frame=header.exact, steps=checkpoints)
        self._addresses = AddressReserve(header.bodies)
        self._encoder: BatchEncoder | None = None
        self._references: set[str] = set()  # names of the magnitudes sent so far
        self._camera_fit: CameraFit | None = None
        self._laid_out = False
        self._added = Additions(viewer_time=viewer_time(header.units, self._clock))
        self._looked = 0  # value of `frames` at the last update of the camera
        self._last: Frame | None = None
        self._last_checkpoint = -1
        self._error: RecordingError | None = None
        self._closed = False
        self._start: FloatArray | None = None  # (n, 3) m, first positions of the centres
        self._start_known = threading.Event()  # set once `_start` is known, or the recorder is closed
        self._begun = threading.Event()  # set once static data are in the file, or cannot get there
        self._thread = threading.Thread(target=self._run, name="carom-recorder", daemon=True)
        self._thread.start()

    @property
    def payload_bytes(self) -> int:
        """Bytes of all arrays recorded so far, as handed to Rerun."""
        return self._stream.payload_bytes

    @property
    def impacts(self) -> RecordedImpacts | None:
        """Number of impacts recorded so far; None if the scene records none."""
        return self._encoder.impacts if self._encoder else None

    def begin(self, position: FloatArray) -> None:
        """Write the static data, given the initial centres (n, 3) in m; without this call, the first `put` writes them.

        A run that fails before its first frame then leaves a readable file.
        """
        self._start = position.copy()
        self._start_known.set()
        if self._addresses.limited:  # frames with many contacts may leave too little address space for the static data
            self._begun.wait()

    def store_for(self, bodies: Bodies) -> FrameStore:
        """Begin, and return memory for frames; the arrays of a frame are reused after it has been recorded."""
        self.begin(bodies.position)
        self._store = FrameStore(self._slots, bodies, self._queue.wait_for_room)
        return self._store

    def extend(self, header: Header) -> None:
        """Add bodies: later frames have the bodies of this header, which begins with the previous header's bodies."""
        self._extended[header.bodies] = header
        self.bodies = header.bodies

    def put(self, frame: Frame) -> None:
        """Hand over a frame; wait while the queue is full. Raises the error that stopped the recorder, if any."""
        if not self._start_known.is_set():
            self.begin(frame.position)
        self._queue.put(frame)

    def finish(self, outcome: str, summary: Mapping[str, Scalar] | None = None, events: tuple[Event, ...] = ()) -> None:
        """Write the remaining frames, the last events and the outcome, close the file, and open it to check it."""
        if self._closed:
            return
        self._stop()
        self._closed = True
        if self._error is not None:
            raise self._error
        self._close(outcome, summary or {}, events)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: object, error: BaseException | None, traceback: object) -> None:
        """Close an unfinished recording with the outcome "interrupted"."""
        if not self._closed and self._error is None:
            reason = "interrupted" if error is None else f"interrupted: {type(error).__name__}: {error}"
            self.finish(reason)
        self._stop()
        self._closed = True

    def _stop(self) -> None:
        """End the thread after it has written the queue."""
        self._start_known.set()
        self._queue.close()
        self._thread.join()

    def _run(self) -> None:
        try:
            self._record()
        except RecordingError as error:
            self._fail(error)
        except MemoryError:
            remedy = "lower the number of bodies, or raise the limit of the address space (`ulimit -v`)"
            self._fail(RecorderError(f"cannot write more of {self.path}: no memory is left; {remedy}"))
        except Exception as error:  # any failure must reach the physics thread
            self._fail(RecorderError(f"recording {self.path} failed: {type(error).__name__}: {error}"))
        finally:
            self._begun.set()

    def _record(self) -> None:
        self._start_known.wait()
        start, self._start = self._start, None
        if start is None:
            return
        encoder = self._begin(start)
        del start
        self._begun.set()
        while (batch := self._queue.take(self._stream.patience)) is None or batch:
            if batch is None:  # waiting rows become due during a long step
                self._stream.flush()
            else:
                self._write(batch, encoder)

    def _write(self, batch: list[Frame], encoder: BatchEncoder) -> None:
        self._addresses.require(batch, self.path)
        # parts of the batch: cut where the frame store wrapped around to its first slot, and where bodies entered
        parts: list[list[Frame]] = []
        for frame in batch:
            if parts and frame.slot != 0 and len(frame.position) == len(parts[-1][-1].position):
                parts[-1].append(frame)
            else:
                parts.append([frame])
        for part in parts:
            if (bodies := len(part[0].position)) != encoder.header.bodies:
                encoder.extend(self._extended[bodies])
            for rows in encoder.rows(part, self._store):
                self._stream.send(rows, self._clock)
        known = encoder.arrow_references
        # sent now, so that the file of a killed run has the references
        self._stream.send_property("arrows", {name: known[name] for name in known if name not in self._references})
        self._references = set(known)
        if self._lives.add(batch):
            self._stream.send_bodies(encoder.header, self._clock, encoder.origin, self._lives)
        kept = self._plan.chosen(batch)
        if kept:
            self._stream.send(encoder.checkpoints(kept), self._clock)
            self._last_checkpoint = kept[-1].step
        self._look(batch, encoder.origin)
        self._last = batch[-1]
        # counted even if the disk is full at the flush, since the reserve had space for these frames
        self.frames += len(batch)
        self._stream.flush()

    def _begin(self, position: FloatArray) -> BatchEncoder:
        """Send all static data; for a resumed run, then send the frames that it continues."""
        self._addresses.release()
        continued, entries = self._continued, self.header.entries
        if entries is not None:  # the view should contain the places where waiting bodies enter
            position = entries.position
        elif continued is not None:
            position = continued.recording.checkpoint(continued.recording.checkpoint_steps[0]).position
        if continued is not None:
            origin = continued.origin
            self._encoder = BatchEncoder(
                *(self.header, origin, continued.arrow_references, continued.last_state, continued.last()),
                impacts_before=continued.impacts,
                floors_before=continued.arrow_floors,
            )
            if continued.frames:
                self._encoder.curves |= recorded_curves(continued.recording, continued.step)
        else:
            there = np.isfinite(position).all(axis=1)  # if bodies come and go, some do not exist yet
            origin = np.average(position[there], axis=0, weights=self.header.mass[there])
            self._encoder = BatchEncoder(self.header, origin)
        reach = float(np.nanmax(np.abs(position - origin).max(axis=1) + self.header.radius))
        self._camera_fit = CameraFit.of_scene(self.header, origin, position - origin)
        self._stream.send_statics(self._clock, origin, reach)
        self._stream.flush()  # without this flush, the frames of a killed run could not be read
        if continued is not None:
            self._stream.send_continued(continued)
            self.frames = continued.frames
        return self._encoder

    def _look(self, batch: list[Frame], origin: FloatArray) -> None:
        """Update the camera; send a first layout early, for a live viewer and for a run that is killed."""
        assert self._camera_fit is not None, "it begins with the first batch"
        is_long = self.payload_bytes > _LAID_OUT_AFTER and time.monotonic() - self._opened > _BATCH_SECONDS
        if not self._laid_out and (self._stream.is_live or is_long):
            self._stream.send_blueprint(blueprint(self.header, self._camera_fit, added=self._added))
            self._laid_out = True
        # an update takes a millisecond, and the physics waits for it
        if self._camera_fit.is_few or self.frames >= _LOOK * self._looked:
            self._looked = self.frames
            self._camera_fit.see(batch, origin)

    def _fail(self, error: RecordingError) -> None:
        """Close the file in its present state, then report the error to the physics thread."""
        try:
            self._close(f"{status_of(error)}: {error}", {}, ())
        except Exception as second:  # report the first error
            error.add_note(f"closing it also failed: {second}")
            if self._file != self.path.resolve():
                error.add_note(f"{self.path} is unchanged; the new frames are in {self._file}")
        self._error = error
        self._queue.fail(error)

    def _close(self, outcome: str, summary: Mapping[str, Scalar], events: tuple[Event, ...]) -> None:
        """Write the end, close the file, open it to check that it has all frames, and give it its name."""
        last, encoder = self._last, self._encoder
        self._addresses.release()
        try:
            if last is not None and encoder is not None:
                if last.step != self._last_checkpoint:
                    self._stream.send(encoder.checkpoints([last]), self._clock)
                level = "INFO" if outcome == "completed" else "WARN"
                for event in (*events, Event(last.step, last.time, level, f"end: {outcome}", "end")):
                    self._stream.send(event_rows([event]), self._clock)
                if self._camera_fit is not None:  # the final layout shows the whole recording, without empty plots
                    self._camera_fit.see([last], encoder.origin)
                    layout = blueprint(self.header, self._camera_fit, encoder.curves, added=self._added)
                    self._stream.send_blueprint(layout)
                if self._lives.change:
                    self._stream.send_bodies(encoder.header, self._clock, encoder.origin, self._lives)
            kept = {} if self.impacts is None else {f"impacts.{key}": n for key, n in asdict(self.impacts).items()}
            self._stream.send_property("outcome", {"outcome": outcome, "frames": self.frames, **kept, **summary})
        finally:
            self._stream.close()
        count = Recording.open(self._file).frames
        if count != self.frames:
            raise RecordingError(f"{self._file} holds {count} frames, but {self.frames} were written")
        try:
            target = self.path.resolve()
            if self._file != target:
                if target.exists():
                    self._file.chmod(target.stat().st_mode & 0o777)
                self._file.replace(target)
        except OSError as error:
            raise RecordingError(
                f"cannot replace {self.path}: {error.strerror}; the new recording is {self._file}"
            ) from error
