"""Commands to show in messages."""

from __future__ import annotations

import shlex


def command(*words: object) -> str:
    """Write a carom command, quoted as a shell needs it, such as ``carom view 'my run.rrd'``."""
    return shlex.join(["carom", *map(str, words)])
