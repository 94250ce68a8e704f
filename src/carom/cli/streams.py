"""Standard output and standard error that never end a command: text that cannot be printed is dropped."""

from __future__ import annotations

import io
import os
import sys
from typing import TYPE_CHECKING, TextIO

if TYPE_CHECKING:
    from _typeshed import ReadableBuffer


class Lossy(io.RawIOBase):
    """Writes to a file descriptor until that fails once; drops everything after that."""

    def __init__(self, descriptor: int) -> None:
        super().__init__()
        self.error: OSError | None = None
        self._descriptor = descriptor

    def write(self, data: ReadableBuffer, /) -> int:
        """Write, or drop; tell how many bytes are done with."""
        if self.error is None:
            try:
                return os.write(self._descriptor, data)
            except OSError as error:
                self.error = error
        return memoryview(data).nbytes

    def fileno(self) -> int:
        """Return the descriptor."""
        return self._descriptor

    def isatty(self) -> bool:
        """Tell whether a person reads it."""
        return os.isatty(self._descriptor)

    def writable(self) -> bool:
        """Return True."""
        return True


def install() -> Lossy:
    """Replace ``sys.stdout`` and ``sys.stderr``; return the one below standard output, which knows if it failed.

    Characters that the encoding of a terminal lacks are printed as question marks.
    """
    for descriptor in range(3):  # a recording must not be opened as standard error, to which libraries print
        try:
            os.fstat(descriptor)
        except OSError:
            os.open(os.devnull, os.O_RDWR)
    out, err = Lossy(1), Lossy(2)
    sys.stdout = _text(out, sys.stdout)
    sys.stderr = _text(err, sys.stderr)
    return out


def _text(raw: Lossy, before: TextIO | None) -> io.TextIOWrapper:
    """Return a text stream with the encoding of the one before; it is None where the descriptor was closed."""
    encoding = before.encoding if before is not None else "utf-8"
    buffered = io.BufferedWriter(raw)
    return io.TextIOWrapper(buffered, encoding, errors="replace", line_buffering=raw.isatty() or raw.fileno() == 2)
