"""How long a person waits: the first run on a machine (kernels compile) and the next ones.

python benchmarks/startup.py
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

FIRST_STEP = """
import time; began = time.perf_counter()
from carom.scene.load import Scene
from carom.runs.run import simulate
from carom.physics.space import Space
space = Space(Scene.load("cloud-collapse"))
space.compute_dynamics(1)
print(time.perf_counter() - began)
"""


def timed(command: list[str], environment: dict[str, str], folder: str) -> tuple[float, str]:
    began = time.perf_counter()
    done = subprocess.run(command, env=environment, cwd=folder, capture_output=True, text=True, check=True)
    return time.perf_counter() - began, done.stdout


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        environment = {**os.environ, "NUMBA_CACHE_DIR": str(Path(folder) / "cache")}
        run = [sys.executable, "-m", "carom", "run", "cloud-collapse", "--force"]
        for name in ("first run, compiling", "second run", "third run"):
            print(f"{name}: {timed(run, environment, folder)[0]:.2f} s in all")
        for _ in range(3):
            wall, inside = timed([sys.executable, "-c", FIRST_STEP], environment, folder)
            print(f"process start to the end of the first step: {wall:.2f} s (imports to step: {float(inside):.2f} s)")
        print(f"carom --help: {timed([sys.executable, '-m', 'carom', '--help'], environment, folder)[0]:.2f} s")


if __name__ == "__main__":
    main()
