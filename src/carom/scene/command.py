"""A command of carom's for a person to type."""

from __future__ import annotations

import shlex


def command(*words: object) -> str:
    """Write a command with its words quoted where a shell needs it, such as ``carom view 'my run.rrd'``."""
    return shlex.join(["carom", *map(str, words)])
