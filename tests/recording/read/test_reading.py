"""Reading never simulates."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path


def test_a_file_is_read_without_the_compiler_and_the_viewer(recorded: Path) -> None:
    program = f"""
import sys, carom
recording = carom.Recording.open({str(recorded)!r})
recording.summary(), recording.energy(), recording.steps(), recording.events(), recording.drawn_positions(0)
print([name for name in ("numba", "rerun") if name in sys.modules])
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert (done.stdout, done.stderr) == ("[]\n", "")
