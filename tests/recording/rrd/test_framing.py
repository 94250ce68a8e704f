import struct
from pathlib import Path

import pytest

from carom.errors import DamageError
from carom.recording.rrd.framing import MessageSplitter, messages

HEADER = b"RRF2" + bytes(8)
MESSAGES = [struct.pack("<QQ", 2, len(body)) + body for body in (b"first", b"", b"x" * 5000)]
END = struct.pack("<QQ", 0, 4) + b"foot"
STREAM_FOOTER = b"RRF2FOOT".rjust(32, b".")


def fed(splitter: MessageSplitter, piece: bytes) -> list[bytes]:
    """Add a piece; return every message that it completes."""
    splitter.add(piece)
    found = list[bytes]()
    while splitter.pass_on(lambda message: found.append(bytes(message))):
        pass
    return found


@pytest.mark.parametrize("size", [1, 7, 16, 100_000])
def test_messages_come_out_whole_however_the_stream_is_cut(size: int) -> None:
    stream = HEADER + b"".join(MESSAGES) + END + STREAM_FOOTER
    splitter = MessageSplitter()
    whole = [m for start in range(0, len(stream), size) for m in fed(splitter, stream[start : start + size])]
    assert whole == [HEADER, *MESSAGES, END, STREAM_FOOTER]


def test_a_torn_message_is_held_back() -> None:
    splitter = MessageSplitter()
    assert fed(splitter, HEADER + MESSAGES[0] + MESSAGES[2][:-1]) == [HEADER, MESSAGES[0]]
    assert fed(splitter, MESSAGES[2][-1:]) == [MESSAGES[2]]


@pytest.mark.parametrize("missing", [1, 15, 16, 17])
def test_a_message_that_the_file_does_not_hold_whole_is_damage(missing: int, tmp_path: Path) -> None:
    body = b"x" * 40
    (tmp_path / "torn.rrd").write_bytes(HEADER + struct.pack("<QQ", 2, len(body)) + body[: len(body) - missing])
    with (tmp_path / "torn.rrd").open("rb") as file, pytest.raises(DamageError, match="ends inside a message"):
        list(messages(file))
