"""An exclusive lock on an output file, since two processes that write one file would destroy both recordings."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import os
from pathlib import Path
from types import TracebackType
from typing import Self

from carom.errors import RecordingError

_NO_LOCKS = (errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP)


class Claim:
    """Keeps other carom processes from writing a path, until it is released or the process ends.

    The lock is on a file beside the output, ``.NAME.lock``, because the output itself may be replaced by another file
    while it is claimed. A killed process leaves that file, which then locks nothing. File systems without locks, such
    as some network ones, do not refuse the second writer.

    Raises
    ------
    RecordingError
        If another process writes the path, or it cannot be written.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            real = path.resolve()
            self._lock = real.with_name(f".{real.name}.lock")
            self._descriptor = _locked(self._lock)
        except BlockingIOError:
            raise RecordingError(
                f"{path}: another carom is writing it; wait for its end, or name another file"
            ) from None
        except (OSError, RuntimeError) as error:  # RuntimeError: links in a circle
            reason = error.strerror if isinstance(error, OSError) else error
            raise RecordingError(f"cannot write {path}: {reason}") from error

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.release()

    def release(self) -> None:
        """Release the path."""
        with contextlib.suppress(OSError):
            self._lock.unlink()  # while still locked: a process that opened it meanwhile notices that it is gone
        os.close(self._descriptor)


def _locked(path: Path) -> int:
    """Open and lock a file that is still there once it is locked; BlockingIOError if another has the lock."""
    while True:
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o666)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            if error.errno not in _NO_LOCKS:
                os.close(descriptor)
                raise
        with contextlib.suppress(FileNotFoundError):
            if os.path.samestat(os.fstat(descriptor), path.stat()):
                return descriptor
        os.close(descriptor)
