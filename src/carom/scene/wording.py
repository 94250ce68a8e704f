"""The words of a message for the one who reads it: a person at a shell, or a program in Python."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

_AT_A_SHELL = [False]


@contextmanager
def at_a_shell() -> Iterator[None]:
    """Word messages for a person who typed a command, in this context."""
    before, _AT_A_SHELL[0] = _AT_A_SHELL[0], True
    try:
        yield
    finally:
        _AT_A_SHELL[0] = before


def worded(in_a_command: str, in_python: str) -> str:
    """Return one of two wordings of a remedy."""
    return in_a_command if _AT_A_SHELL[0] else in_python


def override_called(text: str) -> str:
    """Name an override as it was given."""
    return worded(f"--set {text}", f"the override {text}")
