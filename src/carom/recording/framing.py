"""How an .rrd file is cut into messages, so that a writer can stop at the end of one.

A stream header of 12 bytes (``RRF2``, version, options) is followed by messages: kind and length as little-endian
uint64, then so many bytes. Message kind 0 ends the stream and holds the footer; 32 bytes of stream footer follow it.
A file that ends inside a message is refused by every reader; one that ends between two messages opens.
"""

from __future__ import annotations

import struct

STREAM_HEADER = 12
MESSAGE_HEADER = 16
STREAM_FOOTER = 32
END = 0

_MESSAGE = struct.Struct("<QQ")


class MessageSplitter:
    """Cuts a stream of bytes, fed in pieces of any size, into whole messages.

    The stream header counts as the first message, and what follows the end message (the stream footer) as the last.
    """

    def __init__(self) -> None:
        self._pending = bytearray()
        self._in_messages = False
        self._ended = False

    def feed(self, piece: bytes) -> list[bytes]:
        """Take a piece; hand out every message that it completes."""
        self._pending += piece
        whole: list[bytes] = []
        while (length := self._next_length()) is not None and length <= len(self._pending):
            whole.append(bytes(self._pending[:length]))
            del self._pending[:length]
        return whole

    def _next_length(self) -> int | None:
        """Bytes of the next message, None while too little of it is there to tell."""
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
