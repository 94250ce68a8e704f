"""The recorder in a process of its own, behind a pipe.

In a thread of the simulation's process a recorder takes the interpreter's lock for most of its time, and the physics,
which wants the lock back after every kernel, waits for it: recording every step of 1000 bodies then costs a third of
the run (benchmarks/recording.py), though a second core is idle. Here the physics only hands a frame to a thread that
writes it into a pipe. Queue and pipe are bounded and block when they are full: no frame is dropped, and none piles up.

It is also the safer form: a simulation that is killed leaves a process behind that closes the file properly.
"""

from __future__ import annotations

import contextlib
import os
import pickle
import queue
import subprocess
import sys
import threading
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

import carom
from carom.physics.frame import Event, Frame
from carom.recording.errors import RecordingError
from carom.recording.header import Header, Scalar

if TYPE_CHECKING:
    from carom.recording.recorder import Recorder

_QUEUE_BYTES = 64_000_000
_MOST_FRAMES = 512
_WAKE = 0.1  # s; how soon a blocked `put` learns that the recorder failed
_PIPE = 1 << 20  # bytes; the most an unprivileged process may ask for
_SERVE = "from carom.recording.process import serve; serve()"
_ABANDONED = "interrupted: the simulation ended without a word"


class RecorderProcess:
    """Writes one recording, like `Recorder`, without costing the physics more than handing over a frame."""

    def __init__(self, path: str | Path, header: Header, *, live: str | None = None) -> None:
        self.path = Path(path)
        self.frames = 0
        self.payload_bytes = 0
        home = str(Path(carom.__file__).parents[1])
        search = os.pathsep.join(filter(None, (home, os.environ.get("PYTHONPATH", ""))))
        self._child = subprocess.Popen(
            [sys.executable, "-c", _SERVE],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env={**os.environ, "PYTHONPATH": search},
            start_new_session=True,  # the interrupt key is for the simulation, which then ends the recording
        )
        assert self._child.stdin is not None and self._child.stdout is not None
        self._to, self._from = self._child.stdin, self._child.stdout
        _enlarge(self._to)
        frame_bytes = 200 * header.bodies + 2000
        self._queue: queue.Queue[object] = queue.Queue(max(2, min(_MOST_FRAMES, _QUEUE_BYTES // frame_bytes)))
        self._error: RecordingError | None = None
        self._queue.put((str(self.path.absolute()), header, live))
        self._feeder = threading.Thread(target=self._feed, name="carom-feeder", daemon=True)
        self._feeder.start()

    def put(self, frame: Frame) -> None:
        """Hand over a frame; wait while the queue is full. Raises what stopped the recorder, if anything did."""
        self._enqueue(frame)

    def finish(self, outcome: str, summary: Mapping[str, Scalar] | None = None, events: tuple[Event, ...] = ()) -> None:
        """Write what is left, the last events and the outcome, close the file, and open it again to check it."""
        self._enqueue((outcome, dict(summary or {}), events))
        self._enqueue(None)
        self._feeder.join()
        if self._error is not None:
            raise self._error
        self.frames, self.payload_bytes = self._answer()
        self._child.wait()

    def _enqueue(self, message: object) -> None:
        while True:
            if self._error is not None:
                raise self._error
            with contextlib.suppress(queue.Full):
                self._queue.put(message, timeout=_WAKE)
                return

    def _feed(self) -> None:
        """Write what is queued into the pipe; the child's answer explains a pipe that breaks."""
        try:
            while (message := self._queue.get()) is not None:
                pickle.dump(message, self._to, protocol=5)
                self._to.flush()
        except OSError:
            try:
                self._answer()
                self._error = RecordingError(f"recording {self.path} ended too early")
            except RecordingError as error:
                self._error = error

    def _answer(self) -> Any:
        try:
            answer = pickle.load(self._from)
        except EOFError:
            code = self._child.wait()
            raise RecordingError(f"the process that records {self.path} ended with exit code {code}") from None
        if isinstance(answer, RecordingError):
            raise answer
        return answer


def serve() -> None:
    """Record what comes through standard input: who, then frames, then the outcome. This is the child."""
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # whatever a library prints must not get between the answers
    with contextlib.suppress(BrokenPipeError):  # nobody is left to hear the answer
        try:
            answer: object = _record(sys.stdin.buffer)
        except RecordingError as error:
            answer = error
        except Exception as error:
            answer = RecordingError(f"recording failed: {type(error).__name__}: {error}")
        pickle.dump(answer, answers)
        answers.flush()
    os._exit(0)  # Rerun's threads have nothing left to do, and one that hangs must not keep the process


def _record(frames: BinaryIO) -> tuple[int, int]:
    """Return the number of frames and the bytes of their arrays."""
    from carom.recording.recorder import Recorder  # noqa: PLC0415 - the simulation's process needs no Rerun

    path, header, live = pickle.load(frames)
    recorder = Recorder(path, header, live=live)
    outcome, summary, events = _until_the_end(frames, recorder)
    recorder.finish(outcome, summary, events)
    return recorder.frames, recorder.payload_bytes


def _until_the_end(frames: BinaryIO, recorder: Recorder) -> tuple[str, Mapping[str, Scalar], tuple[Event, ...]]:
    while True:
        try:
            message = pickle.load(frames)
        except (EOFError, pickle.UnpicklingError):
            return _ABANDONED, {}, ()
        if not isinstance(message, Frame):
            outcome, summary, events = message
            return outcome, summary, events
        recorder.put(message)


def _enlarge(pipe: Any) -> None:
    """Make room for a few frames where the system lets us."""
    with contextlib.suppress(ImportError, AttributeError, OSError):
        import fcntl  # noqa: PLC0415 - not everywhere

        fcntl.fcntl(pipe, fcntl.F_SETPIPE_SZ, _PIPE)
