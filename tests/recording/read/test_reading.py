"""Reading never simulates."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path


def test_a_file_is_read_without_the_compiler(recorded: Path) -> None:
    program = f"""
import sys, carom
recording = carom.Recording.open({str(recorded)!r})
recording.summary(), recording.energy(), recording.steps(), recording.events(), recording.drawn_positions(0)
print("numba" in sys.modules)
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert (done.stdout, done.stderr) == ("False\n", "")
