"""Time and memory of runs of 10² to 10⁷ bodies with gravity by the tree, with every frame recorded.

    python benchmarks/many_bodies.py [--bodies N ...] [--method tree] [--most GIGABYTES]

A ball of points at rest, given as arrays, without contacts: a frame has positions only, and a checkpoint also
velocities and accelerations. Each size has a process of its own. CPU time is that of the whole process, with the
recorder and helper threads. Peak memory is the largest resident set, all libraries included; a process that needs more
than `--most` GB is killed.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

import carom
from carom.scene.load import Scene
from measurement import forget_peak, merge, peak_megabytes

SIZES = [10**k for k in range(2, 8)]
STEPS_OF_ALL = 3_000_000  # bodies times steps, but at least `FEWEST` steps and at most `MOST`
FEWEST, MOST = 3, 300
DT = 0.01  # s
LIMIT = 16.0  # GB
LOOK = 0.05  # s, between two measurements of the memory


def scene(n: int, method: str, steps: int) -> Scene:
    rng = np.random.default_rng(0)
    position = rng.standard_normal((n, 3))
    position *= (np.cbrt(rng.uniform(0.0, 1.0, n)) / np.linalg.norm(position, axis=1))[:, None]
    return Scene.from_arrays(
        position=position,
        radius=1e-4,
        mass=1.0 / n,
        name="body",
        gravity={"constant": 1.0, "method": method, "softening": 1e-3},
        contact={"enabled": False},
        time={"fixed_dt": DT, "duration": steps * DT},
        record={"every": "step"},
    )


def measure(n: int, method: str) -> dict[str, Any]:
    """Run in this process; return its time and memory."""
    steps = max(FEWEST, min(MOST, STEPS_OF_ALL // n))
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "run.rrd"
        carom.run(scene(64, method, 2), file)  # loads the kernels
        given = scene(n, method, steps)
        forget_peak()
        start, began = time.process_time(), time.perf_counter()
        carom.run(given, file, force=True)
        seconds = {"cpu": time.process_time() - start, "wall": time.perf_counter() - began}
        return {
            "bodies": n,
            "method": method,
            "steps": steps,
            "seconds": seconds,
            "peak_gigabytes": peak_megabytes() * 2**20 / 1e9,
            "file_megabytes": file.stat().st_size / 1e6,
        }


def measure_apart(n: int, method: str, most: float) -> dict[str, Any]:
    """Run in a process of its own, which is killed if it takes more than ``most`` GB."""
    command = [sys.executable, __file__, "--one", str(n), "--method", method]
    child = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    while child.poll() is None:
        pages = int(Path(f"/proc/{child.pid}/statm").read_text(encoding="ascii").split()[1])
        if pages * os.sysconf("SC_PAGE_SIZE") > most * 1e9:
            child.kill()
            raise SystemExit(f"{n} bodies take more than {most:g} GB")
        time.sleep(LOOK)
    assert child.stdout is not None
    found: dict[str, Any] = json.loads(child.stdout.read().splitlines()[-1])
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description="Time and memory of 10² to 10⁷ bodies.")
    parser.add_argument("--bodies", type=int, nargs="+", default=SIZES)
    parser.add_argument("--method", default="tree")
    parser.add_argument("--most", type=float, default=LIMIT)
    parser.add_argument("--one", type=int)
    chosen = parser.parse_args()
    if chosen.one:
        print(json.dumps(measure(chosen.one, chosen.method)))
        return
    for n in chosen.bodies:
        row = measure_apart(n, chosen.method, chosen.most)
        a_step = row["seconds"]["cpu"] / row["steps"]
        memory, size = row["peak_gigabytes"], row["file_megabytes"]
        print(f"{n:>9} bodies {a_step:>10.4g} CPU s a step {memory:>6.2f} GB {size:>9.1f} MB in the file", flush=True)
        merge("many_bodies", {"rows": [row]})


if __name__ == "__main__":
    main()
