"""The boundaries of the messages in an .rrd file, so that a writer can stop at the end of a message.

A stream header of 12 bytes (``RRF2``, version, options) is followed by messages: kind and length as little-endian
uint64, then as many bytes as the length. Message kind 0 ends the stream and holds the footer; 32 bytes of stream footer
follow it. Every reader refuses a file that ends inside a message, but opens a file that ends between two messages.
"""

from __future__ import annotations

import os
import re
import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import xxhash

from carom.errors import DamageError, TornFooterError

STREAM_HEADER = 12
MESSAGE_HEADER = 16
STREAM_FOOTER = 32
END, STORE, CHUNK, ACTIVATION = 0, 1, 2, 3  # kinds of messages

_MAGIC, _PROTOBUF = b"RRF2", 2
_MESSAGE = struct.Struct("<QQ")
# layout of the footer: offset, length and checksum of the end message's body; magic, number of footers
_FOOTER = struct.Struct("<QQI8sI")
_FOOTER_MAGIC = b"RRF2FOOT"
_FOOTER_SEED = 7850921  # seed of the checksum


@dataclass(frozen=True, slots=True)
class Message:
    """Position of a message's body in a file."""

    kind: int
    offset: int
    length: int

    @property
    def end(self) -> int:
        """Offset of the next message."""
        return self.offset + self.length


def is_rrd(file: BinaryIO) -> bool:
    """Return whether a file begins like a readable .rrd."""
    file.seek(0)
    header = file.read(STREAM_HEADER)
    return len(header) == STREAM_HEADER and header.startswith(_MAGIC) and header[9] == _PROTOBUF


def is_newer(file: BinaryIO) -> bool:
    """Return whether a file begins like an .rrd of a later format, or with messages in a later encoding."""
    file.seek(0)
    header = file.read(STREAM_HEADER)
    if not re.match(rb"RRF[2-9]", header) or len(header) < STREAM_HEADER:
        return False
    return not header.startswith(_MAGIC) or header[9] > _PROTOBUF


def looks_recorded(path: Path) -> bool:
    """Return whether a file begins or ends like a recording of any version: such a file may be repaired."""
    try:
        with path.open("rb") as file:
            begins = file.read(len(_MAGIC))
            file.seek(max(0, os.fstat(file.fileno()).st_size - STREAM_FOOTER))
            return begins == _MAGIC or _FOOTER_MAGIC in file.read(STREAM_FOOTER)
    except OSError:
        return False


def messages(file: BinaryIO, start: int = STREAM_HEADER) -> Iterator[Message]:
    """Yield the messages up to the end message or the end of the file; DamageError if no complete message follows."""
    size = os.fstat(file.fileno()).st_size
    while start < size:
        file.seek(start)
        header = file.read(MESSAGE_HEADER)
        if len(header) < MESSAGE_HEADER:
            raise DamageError("it ends inside a message")
        kind, length = _MESSAGE.unpack(header)
        if kind > ACTIVATION:
            raise DamageError(f"no message begins at byte {start}")
        if length > size - start - MESSAGE_HEADER:
            if kind == END:
                raise TornFooterError("it ends inside its footer")
            raise DamageError("it ends inside a message")
        message = Message(kind, start + MESSAGE_HEADER, length)
        yield message
        if kind == END:
            return
        start = message.end


def read_footer(file: BinaryIO) -> bytes | None:
    """Read the end message's body, which locates the chunks; None without a footer, DamageError if it is damaged."""
    size = os.fstat(file.fileno()).st_size
    file.seek(max(0, size - STREAM_FOOTER))
    last = file.read(STREAM_FOOTER)
    if len(last) < STREAM_FOOTER or last[20:28] != _FOOTER_MAGIC:
        return None
    offset, length, checksum, _, _ = _FOOTER.unpack(last)
    if offset + length > size - STREAM_FOOTER:
        raise DamageError("its footer points outside of it")
    file.seek(offset)
    body = file.read(length)
    if xxhash.xxh32(body, seed=_FOOTER_SEED).intdigest() != checksum:
        raise DamageError("its footer does not have its checksum")
    return body


def is_footer(file: BinaryIO, at: int) -> bool:
    """Return whether a stream footer begins at an offset."""
    file.seek(at)
    return file.read(STREAM_FOOTER)[20:28] == _FOOTER_MAGIC


class MessageSplitter:
    """Cuts a stream of bytes, fed in pieces of any size, into its header, whole messages, and its footer."""

    def __init__(self) -> None:
        self._pending = bytearray()
        self._in_messages = False
        self._ended = False

    def add(self, piece: bytes | memoryview) -> None:
        """Add a piece; after a MemoryError, the same piece may be added again."""
        self._pending += piece

    def pass_on(self, write: Callable[[memoryview], None]) -> bool:
        """Pass the next complete message to a function, which must copy what it keeps; return whether there was one."""
        length = self._next_length()
        if length is None or length > len(self._pending):
            return False
        with memoryview(self._pending) as pending, pending[:length] as message:
            write(message)
        del self._pending[:length]
        return True

    def _next_length(self) -> int | None:
        """Return the size (bytes) of the next message; None while it is unknown."""
        if not self._in_messages:
            self._in_messages = len(self._pending) >= STREAM_HEADER
            return STREAM_HEADER
        if self._ended:
            return STREAM_FOOTER if self._pending else None
        if len(self._pending) < MESSAGE_HEADER:
            return None
        kind, length = _MESSAGE.unpack_from(self._pending)
        self._ended = kind == END and len(self._pending) >= MESSAGE_HEADER + length
        return MESSAGE_HEADER + int(length)
