"""Finds the readable messages of a damaged file, and the gaps between them."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO

from carom.errors import DamageError, TornFooterError
from carom.recording.rrd import framing
from carom.recording.rrd.container import ChunkIndex, Container
from carom.recording.rrd.framing import END, MESSAGE_HEADER, STREAM_FOOTER, STREAM_HEADER, Message
from carom.recording.rrd.messages import LARGEST, RECORDING, Entry, Store, read_body

_WINDOW = 1 << 22  # bytes searched at a time
_MESSAGE = re.compile(rb"[\x00-\x03]\x00{7}[\x00-\xff]{5}\x00{3}\n", re.DOTALL)  # its body starts with field 1, bytes
_PATIENCE = 4  # largest number of bytes read in the search for messages, over the size of the file


@dataclass(frozen=True, slots=True)
class Gap:
    """Bytes that cannot be decoded."""

    offset: int
    length: int
    reason: str


@dataclass(slots=True)
class Salvage:
    """The result of one pass through a file."""

    stores: list[Store] = field(default_factory=list)
    gaps: list[Gap] = field(default_factory=list)
    missing: list[Entry] = field(default_factory=list)  # listed in the footer, but unreadable
    layout_lost: bool = False
    finished: bool = False  # whether it has a footer that matches its chunks


def salvage(path: Path) -> Salvage:
    """Decode every readable message of a file. Raises OSError if the file cannot be read."""
    found = Salvage()
    listed = _listed(path)
    with path.open("rb") as file:
        file.seek(0, 2)
        _Pass(file, file.tell(), found).go()
    if listed is not None:
        _compare(found, listed)
    return found


def _compare(found: Salvage, listed: list[Store]) -> None:
    """Keep only chunks that match the footer."""
    readable = {(store.kind, store.store_id): set(store.entries) for store in found.stores}
    for store in listed:
        gone = [entry for entry in store.entries if entry not in readable.get((store.kind, store.store_id), set())]
        store.entries[:] = [entry for entry in store.entries if entry not in gone]
        if store.kind == RECORDING:
            found.missing += gone
        elif gone:
            found.layout_lost = True
            store.entries.clear()
    found.stores = listed
    found.finished = not (found.missing or found.layout_lost or found.gaps)


def _listed(path: Path) -> list[Store] | None:
    """Read the footer's index; None without a valid one."""
    with path.open("rb") as file:
        try:
            if framing.read_footer(file) is None:
                return None
        except DamageError:
            return None
    try:
        return Container.open(path).stores
    except (DamageError, LookupError, TypeError, ValueError):
        return None


class _Pass:
    """One pass through the messages of a file that skips all other bytes."""

    def __init__(self, file: BinaryIO, size: int, found: Salvage) -> None:
        self._file = file
        self._size = size
        self._found = found
        self._index = ChunkIndex()
        self._budget = _PATIENCE * size

    def go(self) -> None:
        """Go through the file and fill in the result."""
        at = STREAM_HEADER
        if not framing.is_rrd(self._file):
            self._found.gaps.append(Gap(0, STREAM_HEADER, "it does not begin like a recording"))
        while at < self._size:
            try:
                message = self._message(at)
            except TornFooterError:
                break
            except DamageError as error:
                following = self._next(at + 1)
                self._found.gaps.append(Gap(at, following - at, str(error)))
                at = following
                continue
            at = message.end
            if message.kind == END:
                self._end(at)
                break
        self._found.stores = self._index.stores()

    def _end(self, at: int) -> None:
        """Count the bytes after the footer, which starts at an offset, as lost."""
        more = self._size - (at + STREAM_FOOTER)
        if more > 0:
            self._found.gaps.append(Gap(at + STREAM_FOOTER, more, "bytes after its end"))

    def _message(self, at: int) -> Message:
        """Decode and index the message at an offset. Raises DamageError if there is none."""
        message = next(framing.messages(self._file, at))
        self._index.add(message, self._body(message))
        return message

    def _body(self, message: Message) -> bytes:
        if message.kind == END:
            if self._size - message.end >= STREAM_FOOTER and not framing.is_footer(self._file, message.end):
                raise DamageError("an end in the middle")
            return b""
        if message.length > LARGEST:
            raise DamageError(f"a message of {message.length} bytes")
        self._budget -= message.length
        return read_body(self._file, message)

    def _next(self, at: int) -> int:
        """Return the offset of the next readable message, or the file's size."""
        while at < self._size and self._budget > 0:
            self._file.seek(at)
            window = self._file.read(_WINDOW + MESSAGE_HEADER)
            self._budget -= len(window)
            for match in _MESSAGE.finditer(window):
                if self._can_be_read(at + match.start()):
                    return at + match.start()
            at += _WINDOW
        return self._size

    def _can_be_read(self, at: int) -> bool:
        if self._budget <= 0:
            return False
        try:
            message = next(framing.messages(self._file, at))
            ChunkIndex().add(message, self._body(message))
        except DamageError:
            return False
        return True
