"""Addresses that are kept free under ``ulimit -v``: Rerun's encoder aborts the process when there are none left."""

from __future__ import annotations

import mmap
import resource
from collections.abc import Sequence
from pathlib import Path

from carom.errors import RecordingError
from carom.physics.frame import Frame

_STATM = Path("/proc/self/statm")

# Bytes, as measured on heaps of spheres that touch 12 others, rounded up; `plan.limits` counts the bodies.
_FRAME_PER_CONTACT = 400
_CHECKPOINT_PER_CONTACT = 800
_CLOSING = 16_000_000  # what is static, layout, footer, and reading the file once
_CLOSING_PER_CONTACT = 800
_STATIC_PER_BODY = 1000


class AddressReserve:
    """Refuses a batch for which there are too few addresses, while there are still enough to close the file.

    It works only where `ulimit -v` limits addresses and the system tells how many are in use.
    """

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
        """Whether addresses are limited, and the system tells how many are in use."""
        return self._limit is not None

    def require(self, batch: Sequence[Frame], path: Path) -> None:
        """Keep what closing the file needs. RecordingError if that and encoding a batch do not fit."""
        if self._limit is None:
            return
        contacts = [len(frame.contacts.pairs) for frame in batch]
        encoding = _FRAME_PER_CONTACT * sum(contacts) + _CHECKPOINT_PER_CONTACT * max(contacts)
        closing = self._least + _CLOSING_PER_CONTACT * max(contacts)
        if not self._keep(closing) or _in_use() + encoding > self._limit:
            needed = f"{(encoding + closing) / 1e9:.2g} GB of address space"
            raise RecordingError(
                f"cannot write more of {path}: frames of {max(contacts)} contacts need {needed} and "
                f"`ulimit -v` leaves less of its {self._limit / 1e9:.3g} GB; raise the limit"
            )

    def _keep(self, size: int) -> bool:
        """Keep at least so many bytes; tell whether there are as many."""
        if size > self._size:
            self.release()
            try:
                self._kept, self._size = mmap.mmap(-1, size, prot=mmap.PROT_READ), size
            except OSError:
                return False
        return True

    def release(self) -> None:
        """Let others have the addresses."""
        if self._kept is not None:
            self._kept.close()
        self._kept, self._size = None, 0


def _in_use() -> int:
    """Return the bytes of addresses that this process uses."""
    return int(_STATM.read_text(encoding="ascii").split()[0]) * resource.getpagesize()
