"""What recording costs: the same run of 1000 gravitating, colliding bodies with every step recorded, and without.

    python benchmarks/recording.py

Runs are interleaved; the median of the ratios is the cost. Memory is the peak of a child process for a short run and
for one four times as long.
"""

from __future__ import annotations

import resource
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from carom.experiment.run import simulate
from carom.physics.space import Space
from carom.scene.schema import Scene

ROUNDS = 5


def scene(steps: int) -> Scene:
    return Scene.from_dict(
        {
            "seed": 1,
            "gravity": {"constant": 1.0},
            "time": {"duration": steps * 2e-3, "fixed_dt": 2e-3},
            "record": {"every": "step"},
            "group": [
                {
                    "count": 1000,
                    "radius": {"min": 0.2, "max": 0.4},
                    "density": 3.0,
                    "region": {"radius": 5.0},
                    "velocity": {"dispersion": 0.5},
                }
            ],
        }
    )


def without(space: Space) -> float:
    """Step as often, with no energies but the regular checks."""
    began = time.perf_counter()
    while space.time < space.scene.time.duration:
        space.compute_dynamics(space.step + 1)
    return time.perf_counter() - began


def with_recording(space: Space, folder: str) -> tuple[float, float, int]:
    began = time.perf_counter()
    outcome = simulate(space, Path(folder) / "run.rrd", force=True)
    return time.perf_counter() - began, outcome.size / outcome.payload, outcome.moments.total_contacts


def peak_memory(steps: int) -> float:
    """Peak resident memory in MB of a process that records so many steps."""
    code = f"import benchmarks.recording as b; b.record_once({steps})"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return float(done.stdout.strip())


def record_once(steps: int) -> None:
    with tempfile.TemporaryDirectory() as folder:
        with_recording(Space(scene(steps)), folder)
    print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)


def main() -> None:
    steps = 600
    ratios = []
    with tempfile.TemporaryDirectory() as folder:
        with_recording(Space(scene(20)), folder)
        for _ in range(ROUNDS):
            bare = without(Space(scene(steps)))
            recorded, overhead, contacts = with_recording(Space(scene(steps)), folder)
            ratios.append(recorded / bare)
            print(
                f"{steps} steps: {bare:.2f} s without, {recorded:.2f} s recorded ({recorded / bare - 1:+.1%}); "
                f"file {overhead:.3f} of its payload; {contacts} contacts"
            )
    print(f"median cost of recording every step: {statistics.median(ratios) - 1:+.1%}")
    print(f"peak memory: {peak_memory(600):.0f} MB for 600 steps, {peak_memory(2400):.0f} MB for 2400")


if __name__ == "__main__":
    main()
