"""Commands that are printed can be pasted into a shell."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import carom
from carom.scene.wording import command


def test_words_with_spaces_and_quotes_are_quoted() -> None:
    assert command("view", Path("runs/my run.rrd"), "--at", "1.5") == "carom view 'runs/my run.rrd' --at 1.5"
    assert shlex.split(command("replay", "it's.rrd")) == ["carom", "replay", "it's.rrd"]


def test_no_command_is_put_together_without_quoting() -> None:
    unquoted = re.compile(r"carom [a-z]+ (-[^\s\"']+ )*\{")
    for path in Path(carom.__file__).parent.rglob("*.py"):
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), start=1):
            assert not unquoted.search(line), f"{path}:{number}: write it with carom.scene.wording: {line.strip()}"
