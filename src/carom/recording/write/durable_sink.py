"""The end of a recording that touches the disk.

Rerun's file sink is given a pipe instead of the file. A sink whose write fails loses its thread, leaves half a message
behind and can hang the process at exit; so it never sees a failure. What comes out of the pipe is written here, whole
message by whole message. When the disk is full the reserve is dropped and writing goes on: there is room for what is
under way and for a proper end.
"""

from __future__ import annotations

import array
import errno
import fcntl
import os
import resource
import select
import termios
import threading
import time
from pathlib import Path

from carom.recording.errors import RecordingError
from carom.recording.rrd.framing import MessageSplitter
from carom.recording.write.disk_reserve import DiskReserve

_PIPE = 1 << 20  # bytes; the most an unprivileged process may ask for
_POLL = 0.0005  # s
_NO_ROOM = (errno.ENOSPC, errno.EDQUOT)


class DurableSink:
    """Copies a pipe into a file; keeps the file readable whatever happens."""

    def __init__(self, path: Path, reserve: int) -> None:
        self.path = path
        self.full = False  # the disk is full, the reserve is being used: close now
        self.error: OSError | None = None  # nothing can be written any more
        self.messages = 0
        self.written = 0  # bytes, always at the end of a message
        try:
            self._reserve = DiskReserve(path.parent)
            self._reserve.grow(reserve)
            self._file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_CLOEXEC, 0o644)
        except OSError as error:
            raise RecordingError(f"cannot write {path}: {error.strerror}") from error
        self._source, self._entry = os.pipe()
        if hasattr(fcntl, "F_SETPIPE_SZ"):  # Linux; elsewhere a pipe has the size that it has
            fcntl.fcntl(self._entry, fcntl.F_SETPIPE_SZ, _PIPE)
        soft_limit = resource.getrlimit(resource.RLIMIT_FSIZE)[0]
        self._limit = None if soft_limit == resource.RLIM_INFINITY else soft_limit
        self._splitter = MessageSplitter()
        self._turn = threading.Lock()
        self._thread = threading.Thread(target=self._copy, name="carom-sink", daemon=True)
        self._thread.start()

    @property
    def entry(self) -> str:
        """The path that Rerun's file sink opens for writing."""
        return f"/dev/fd/{self._entry}"

    def opened(self) -> None:
        """Tell that the sink has opened the entry: from now on the pipe ends when the sink closes it."""
        os.close(self._entry)

    def reserve(self, size: int) -> None:
        """Keep so many bytes for the end; a disk that has not got them counts as full."""
        if self.full:
            return
        try:
            self._reserve.grow(size)
        except OSError:
            self._use_reserve()

    @property
    def gone(self) -> bool:
        """Whether the file no longer has its name: it was removed, renamed or replaced."""
        try:
            return not os.path.samestat(os.fstat(self._file), self.path.stat())
        except FileNotFoundError:
            return True

    def settle(self) -> None:
        """Wait until all that was flushed into the pipe is in the file."""
        while self._thread.is_alive():
            with self._turn:
                if _bytes_waiting(self._source) == 0:
                    return
            time.sleep(_POLL)

    def close(self) -> None:
        """Wait for the end of the pipe and make the file durable."""
        self._thread.join()
        os.close(self._source)
        self._reserve.release()
        try:
            os.fsync(self._file)
        except OSError as error:
            self.error = self.error or error
        os.close(self._file)

    def _copy(self) -> None:
        while True:
            select.select([self._source], [], [])
            with self._turn:  # read and write in one turn: an empty pipe then means that all is written
                piece = os.read(self._source, _PIPE)
                for message in self._splitter.feed(piece):
                    self._write(message)
            if not piece:
                return

    def _write(self, message: bytes) -> None:
        if self.error is not None:
            return  # keep the pipe empty all the same, or the sink would wait for ever
        if self._limit is not None and self.written + len(message) > self._limit - self._reserve.size:
            self._use_reserve()  # a limit on the file's size is met like a full disk: early enough
        rest = memoryview(message)
        while rest:
            try:
                rest = rest[os.write(self._file, rest) :]
            except OSError as error:
                if error.errno in _NO_ROOM and not self.full:
                    self._use_reserve()
                    continue
                os.ftruncate(self._file, self.written)  # the file ends with a whole message
                self.error = error
                return
        self.written += len(message)
        self.messages += 1

    def _use_reserve(self) -> None:
        self.full = True
        self._reserve.release()


def _bytes_waiting(descriptor: int) -> int:
    count = array.array("i", [0])
    fcntl.ioctl(descriptor, termios.FIONREAD, count)
    return count[0]
