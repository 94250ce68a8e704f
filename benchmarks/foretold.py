"""What `carom explain` foretells beside what a run takes: computing, memory and bytes.

python benchmarks/foretold.py [SCENE …]    the bundled scenes without arguments

The computing is the CPU time of the whole command, which other programs on the machine change by a third at most.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

from carom.scene.scene_file import bundled_scenes

MEGABYTE = 1e6
KILOBYTE = 1024  # the unit of `ru_maxrss` on Linux


def taken(*arguments: str) -> tuple[float, float, str]:
    """Run a command of carom; return its CPU seconds, its peak memory in MB, and what it printed."""
    with tempfile.TemporaryFile("w+") as printed:
        command = subprocess.Popen(
            [sys.executable, "-m", "carom", *arguments], stdout=printed, stderr=subprocess.DEVNULL
        )
        _, _, usage = os.wait4(command.pid, 0)
        printed.seek(0)
        return usage.ru_utime + usage.ru_stime, usage.ru_maxrss * KILOBYTE / MEGABYTE, printed.read()


def main() -> None:
    print("| scene | computing, s | foretold | memory, MB | foretold | recording, MB | foretold |")
    print("|---|---|---|---|---|---|---|")
    with tempfile.TemporaryDirectory() as folder:
        recording = Path(folder) / "run.rrd"
        for scene in sys.argv[1:] or sorted(bundled_scenes()):
            cost = json.loads(taken("explain", scene, "--json")[2])["cost"]
            seconds, memory, _ = taken("run", scene, "-o", str(recording), "--force")
            size = recording.stat().st_size / MEGABYTE
            row = [f"{seconds:.1f}", f"{cost['seconds'] / seconds:.2f} ×", f"{memory:.0f}"]
            row += [f"{cost['memory'] / MEGABYTE / memory:.2f} ×", f"{size:.1f}"]
            row += [f"{cost['size'] / MEGABYTE / size:.2f} ×"]
            print(f"| {' | '.join([Path(scene).stem, *row])} |", flush=True)


if __name__ == "__main__":
    main()
