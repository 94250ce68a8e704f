"""Writes the recording to disk and keeps the file readable when writing fails.

When a write of Rerun's own file sink fails, its thread dies, half a message stays in the file, and the process may hang
at exit. The sink therefore writes to a pipe, which never fails, and `DurableSink` copies the pipe to the file, one
whole message at a time. When the disk is full, it releases a reserve, which provides space for pending messages and the
footer.
"""

from __future__ import annotations

import array
import contextlib
import errno
import fcntl
import mmap
import os
import resource
import select
import tempfile
import termios
import threading
import time
from collections.abc import Sequence
from pathlib import Path

from carom.errors import RecorderError, RecordingError
from carom.recording.rrd.framing import MessageSplitter
from carom.state.frame import Frame


class DiskReserve:
    """An unnamed file beside the recording. Releasing it frees the space for the end of the recording."""

    def __init__(self, folder: Path) -> None:
        self._file = tempfile.TemporaryFile(dir=folder)  # noqa: SIM115  it lives as long as the recording
        self.size = 0

    def grow(self, size: int) -> None:
        """Reserve at least ``size`` bytes. Raises OSError (ENOSPC) if the disk is too full."""
        more = size - self.size
        if more <= 0:
            return
        if hasattr(os, "posix_fallocate"):
            os.posix_fallocate(self._file.fileno(), self.size, more)
        else:  # macOS: only written bytes are certain to be allocated
            self._file.seek(self.size)
            self._file.write(bytes(more))
            self._file.flush()
        self.size = size

    def release(self) -> None:
        """Release the reserved space."""
        self._file.close()


FLUSH = 60.0  # s, time limit for Rerun's stream to the pipe; a disk that takes longer has failed
_SPARE = 32 << 20  # bytes of address space kept for the last messages, in case `ulimit -v` leaves nothing else
_PIPE = 1 << 20  # bytes in a pipe; a user with many pipes gets smaller pipes
_POLL = 0.001  # s
_GATHER = 0.002  # s between two reads; each read acquires the interpreter lock, which the physics needs
_NO_ROOM = (errno.ENOSPC, errno.EDQUOT)


class DurableSink:
    """Copies a pipe into a new file, and keeps the file readable after any failure."""

    def __init__(self, path: Path, reserve: int) -> None:
        self.path = path
        self.full = False  # whether the disk is full and the reserve in use; the recording must then be closed
        self.error: OSError | None = None  # the write error after which nothing more is written
        self.messages = 0
        self.written = 0  # bytes written, always up to the end of a message
        try:
            self._reserve = DiskReserve(path.parent)
            self._reserve.grow(reserve)
            self._file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC, 0o644)
        except OSError as error:
            raise RecordingError(f"cannot write {path}: {error.strerror}") from error
        self._source, self._entry = os.pipe()
        if hasattr(fcntl, "F_SETPIPE_SZ"):  # Linux only
            with contextlib.suppress(OSError):
                fcntl.fcntl(self._entry, fcntl.F_SETPIPE_SZ, _PIPE)
        soft_limit = resource.getrlimit(resource.RLIMIT_FSIZE)[0]
        self._limit = None if soft_limit == resource.RLIM_INFINITY else soft_limit
        self._splitter = MessageSplitter()
        self._spare = mmap.mmap(-1, _SPARE)
        self._piece = memoryview(bytearray(_PIPE))  # allocated now, since there may be no memory later
        self._lock = threading.Lock()
        self._awaited = threading.Event()  # set while another thread waits for the data, which are then read at once
        self._thread = threading.Thread(target=self._copy, name="carom-sink", daemon=True)
        self._thread.start()

    @property
    def entry(self) -> str:
        """The path that Rerun's file sink opens for writing."""
        return f"/dev/fd/{self._entry}"

    def opened(self) -> None:
        """Close our writing end of the pipe once Rerun's sink has opened its own; the pipe then ends with that sink."""
        os.close(self._entry)

    def reserve(self, size: int) -> None:
        """Reserve this many bytes for closing the file; a disk without space for them counts as full."""
        if self.full:
            return
        try:
            self._reserve.grow(size)
        except OSError:
            self._use_reserve()

    @property
    def gone(self) -> bool:
        """Whether the file was removed, renamed or replaced."""
        try:
            return not os.path.samestat(os.fstat(self._file), self.path.stat())
        except FileNotFoundError:
            return True

    def drain(self) -> None:
        """Wait until all flushed data are in the file."""
        self._awaited.set()
        waiting = array.array("i", [1])  # bytes
        while self._thread.is_alive():
            with self._lock:
                fcntl.ioctl(self._source, termios.FIONREAD, waiting)
                if waiting[0] == 0:
                    break
            time.sleep(_POLL)
        self._awaited.clear()

    def close(self) -> None:
        """Wait for the end of the pipe and make the file durable."""
        self._awaited.set()
        self._thread.join()
        os.close(self._source)
        self._reserve.release()
        self._spare.close()
        try:
            os.fsync(self._file)
        except OSError as error:
            self.error = self.error or error
        os.close(self._file)

    def _copy(self) -> None:
        size = 1
        waiting = select.poll()  # `select.select` refuses descriptors above 1023
        waiting.register(self._source, select.POLLIN)
        while size:
            waiting.poll()
            self._awaited.wait(_GATHER)
            with self._lock:  # with the lock, an empty pipe tells `drain` that everything is written
                size = os.readv(self._source, [self._piece])
                # the pipe is read even after an error; otherwise Rerun's sink would block forever
                if self.error is None:
                    self._write_whole(self._piece[:size])

    def _write_whole(self, piece: memoryview) -> None:
        """Write the messages that a piece completes; store any error for later, since the pipe must be drained."""
        try:
            try:
                self._splitter.add(piece)
            except MemoryError:
                self._spare.close()
                self._splitter.add(piece)
            while self._splitter.pass_on(self._write):
                pass
        except MemoryError:
            self.error = OSError(errno.ENOMEM, os.strerror(errno.ENOMEM))
        except Exception as error:
            self.error = OSError(errno.EIO, f"{type(error).__name__}: {error}")

    def _write(self, message: memoryview) -> None:
        if self.error is not None:  # the error belongs to an earlier message
            return
        if self._limit is not None and self.written + len(message) > self._limit - self._reserve.size:
            self._use_reserve()  # treat a file size limit like a full disk, before it is reached
        rest = message
        while rest:
            try:
                rest = rest[os.write(self._file, rest) :]
            except OSError as error:
                if error.errno in _NO_ROOM and not self.full:
                    self._use_reserve()
                    continue
                os.ftruncate(self._file, self.written)  # the file ends with a whole message
                # store the error without its traceback, whose frame would keep `rest` and the splitter's memory alive
                self.error = error.with_traceback(None)
                return
        self.written += len(message)
        self.messages += 1

    def _use_reserve(self) -> None:
        self.full = True
        self._reserve.release()


# Address space kept free under ``ulimit -v``: Rerun's encoder aborts the process when none is left.

_STATM = Path("/proc/self/statm")

# Bytes of address space for encoding, measured on heaps of spheres that touch 12 others, and rounded up; `plan.room`
# accounts for the bodies.
_FRAME_PER_CONTACT = 400
_CHECKPOINT_PER_CONTACT = 800
_CLOSING = 16_000_000  # bytes for static data, layout, footer, and one reading of the file
_CLOSING_PER_CONTACT = 800
_STATIC_PER_BODY = 1000


class AddressReserve:
    """Refuses a batch when limited address space (`ulimit -v`) runs short, but still suffices to close the file."""

    def __init__(self, bodies: int) -> None:
        limit, _ = resource.getrlimit(resource.RLIMIT_AS)
        self._limit = limit if limit != resource.RLIM_INFINITY and _STATM.exists() else None
        self._kept: mmap.mmap | None = None
        self._size = 0
        self._least = _CLOSING + _STATIC_PER_BODY * bodies
        if self._limit is not None:
            self._keep(self._least)

    @property
    def limited(self) -> bool:
        """Whether address space is limited and the system reports its use."""
        return self._limit is not None

    def require(self, batch: Sequence[Frame], path: Path) -> None:
        """Reserve address space for closing the file. RecordingError if too little remains to encode a batch."""
        if self._limit is None:
            return
        contacts = [len(frame.contacts.pairs) for frame in batch]
        encoding = _FRAME_PER_CONTACT * sum(contacts) + _CHECKPOINT_PER_CONTACT * max(contacts)
        closing = self._least + _CLOSING_PER_CONTACT * max(contacts)
        pages = int(_STATM.read_text(encoding="ascii").split()[0])  # pages in use
        if not self._keep(closing) or pages * resource.getpagesize() + encoding > self._limit:
            needed = f"{(encoding + closing) / 1e9:.2g} GB of address space"
            raise RecorderError(
                f"cannot write more of {path}: frames of {max(contacts)} contacts need {needed}, more than `ulimit "
                f"-v` leaves of its {self._limit / 1e9:.3g} GB; raise the limit"
            )

    def _keep(self, size: int) -> bool:
        """Reserve at least ``size`` bytes; return whether that succeeded."""
        if size > self._size:
            self.release()
            try:
                self._kept, self._size = mmap.mmap(-1, size, prot=mmap.PROT_READ), size
            except OSError:
                return False
        return True

    def release(self) -> None:
        """Release the address space."""
        if self._kept is not None:
            self._kept.close()
        self._kept, self._size = None, 0
