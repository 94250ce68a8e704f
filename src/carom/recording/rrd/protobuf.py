"""Decodes the fields of a Protocol Buffers message, as far as the messages of an .rrd need it."""

from __future__ import annotations

from carom.errors import DamageError

Fields = dict[int, list["int | memoryview"]]

_LONGEST_VARINT = 64  # bits
_MOST_FIELDS = 1000  # of a message; an .rrd's have up to six


def fields(message: memoryview) -> Fields:
    """Decode the fields of a message. A field may occur more than once; nested messages stay bytes.

    Raises
    ------
    DamageError
        If the bytes are not a message.
    """
    found: Fields = {}
    at = count = 0
    while at < len(message):
        count += 1
        if count > _MOST_FIELDS:
            raise DamageError("a message of too many fields")
        tag, at = _varint(message, at)
        value: int | memoryview
        match tag & 7:
            case 0:
                value, at = _varint(message, at)
            case 1:
                value, at = _bytes(message, at, 8)
            case 2:
                length, at = _varint(message, at)
                value, at = _bytes(message, at, length)
            case 5:
                value, at = _bytes(message, at, 4)
            case _:
                raise DamageError("a field of unknown wire type")
        found.setdefault(tag >> 3, []).append(value)
    return found


def number(message: Fields, field: int, default: int = 0) -> int:
    """Return an integer field, or the default if it is absent."""
    value = message.get(field, [default])[-1]
    if not isinstance(value, int):
        raise DamageError("bytes where a number should be")
    return value


def data(message: Fields, field: int) -> memoryview:
    """Return a bytes field or nested message; empty if it is absent."""
    value = message.get(field, [memoryview(b"")])[-1]
    if not isinstance(value, memoryview):
        raise DamageError("a number where bytes should be")
    return value


def text(message: Fields, field: int) -> str:
    """Return a text field."""
    try:
        return bytes(data(message, field)).decode()
    except UnicodeDecodeError as error:
        raise DamageError("a text that is not UTF-8") from error


def _varint(message: memoryview, at: int) -> tuple[int, int]:
    value = 0
    for shift in range(0, _LONGEST_VARINT, 7):
        if at >= len(message):
            raise DamageError("a number that does not end")
        byte = message[at]
        at += 1
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            return value, at
    raise DamageError("a number that does not end")


def _bytes(message: memoryview, at: int, length: int) -> tuple[memoryview, int]:
    if length > len(message) - at:
        raise DamageError("a field longer than its message")
    return message[at : at + length], at + length
