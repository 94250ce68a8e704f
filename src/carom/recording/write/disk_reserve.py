"""Reserved disk space, so that a recording can still be closed properly when the disk is full."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path


class DiskReserve:
    """An unnamed file beside the recording. Releasing it frees the space for the end of the recording."""

    def __init__(self, folder: Path) -> None:
        self._file = tempfile.TemporaryFile(dir=folder)  # noqa: SIM115  it lives as long as the recording
        self.size = 0

    def grow(self, size: int) -> None:
        """Reserve at least ``size`` bytes. Raises OSError (ENOSPC) if the disk is too full."""
        if size > self.size:
            self._allocate(size - self.size)
            self.size = size

    def release(self) -> None:
        """Release the reserved space."""
        self._file.close()

    def _allocate(self, more: int) -> None:
        if hasattr(os, "posix_fallocate"):
            os.posix_fallocate(self._file.fileno(), self.size, more)
        else:  # macOS: only written bytes are certain to be allocated
            self._file.seek(self.size)
            self._file.write(bytes(more))
            self._file.flush()
