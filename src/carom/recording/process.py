"""The recorder in a process of its own, behind a pipe.

In a thread of the simulation's process a recorder takes the interpreter's lock for most of its time, and the physics,
which wants the lock back after every kernel, waits for it (benchmarks/recording.py). Here the physics only writes a
frame into a pipe. The pipe holds a few frames and blocks when it is full: none is dropped, and none piles up.

It is also the safer form: a simulation that is killed leaves a process behind that closes the file properly.
"""

from __future__ import annotations

import contextlib
import os
import pickle
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

import numpy as np

import carom
from carom.physics.frame import Event, Frame
from carom.recording.errors import RecordingError
from carom.recording.header import Header, Scalar

if TYPE_CHECKING:
    from carom.recording.recorder import Recorder

_NO_NORMALS = np.empty((0, 3))
_PIPE = 1 << 20  # bytes; the most an unprivileged process may ask for
_SERVE = "from carom.recording.process import serve; serve()"
_ABANDONED = "interrupted: the simulation ended without a word"


class RecorderProcess:
    """Writes one recording, like `Recorder`, without costing the physics more than handing over a frame."""

    def __init__(self) -> None:
        """Start the process; it loads Rerun meanwhile, so start it before other slow things."""
        self.path = Path()
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

    def begin(self, path: str | Path, header: Header, *, live: str | None = None) -> None:
        """Say what is recorded, and where."""
        self.path = Path(path)
        self._send((str(self.path.absolute()), header, live))

    def put(self, frame: Frame) -> None:
        """Hand over a frame; wait while the pipe is full. Raises what stopped the recorder, if anything did."""
        self._send(_slim(frame))

    def finish(self, outcome: str, summary: Mapping[str, Scalar] | None = None, events: tuple[Event, ...] = ()) -> None:
        """Write what is left, the last events and the outcome, close the file, and open it again to check it."""
        self._send((outcome, dict(summary or {}), events))
        self.frames, self.payload_bytes = self._answer()
        self._child.wait()

    def _send(self, message: object) -> None:
        try:
            pickle.dump(message, self._to, protocol=5)
            self._to.flush()
        except OSError:
            self._answer()  # it explains why the pipe broke
            raise RecordingError(f"recording {self.path} ended too early") from None

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
        except EOFError:
            os._exit(0)  # nothing was ever recorded
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


def _slim(frame: Frame) -> Frame:
    """Leave out what is not recorded: angular accelerations follow from the torques, normals from the centres."""
    graph = replace(frame.contacts, normals=_NO_NORMALS)
    return replace(frame, contacts=graph, angular_acceleration=None)


def _enlarge(pipe: Any) -> None:
    """Make room for a few frames where the system lets us."""
    with contextlib.suppress(ImportError, AttributeError, OSError):
        import fcntl  # noqa: PLC0415 - not everywhere

        fcntl.fcntl(pipe, fcntl.F_SETPIPE_SZ, _PIPE)
