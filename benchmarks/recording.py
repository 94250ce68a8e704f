"""What recording costs: the collapse with 1000 bodies, every step recorded, beside the same run without a file.

    python benchmarks/recording.py

Two runs without a file are measured: one that only steps, and one that hands out the same frames, with their energies,
to nobody. Rounds are interleaved and medians compared. Memory is the peak of a child process for a short run and for
one four times as long.
"""

from __future__ import annotations

import resource
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any
from unittest import mock

from carom.experiment.memory import keep_freed_memory

keep_freed_memory()  # as the carom command does, before NumPy starts its threads

from carom.experiment.run import Outcome, simulate  # noqa: E402
from carom.physics.space import Space  # noqa: E402
from carom.scene.schema import Scene  # noqa: E402

ROUNDS = 5
DURATION = 20_000.0  # s simulated, some 7 s of wall time: closing a file takes 0.1 s whatever its length


def scene(duration: float) -> Scene:
    changes = ["group.0.count=1000", "group.0.region.radius=38", "record.every=step", f"time.duration={duration}"]
    return Scene.load("cloud-collapse", changes)


def only_steps(space: Space) -> float:
    """Step as often, with no energies but the regular checks."""
    began = time.perf_counter()
    while space.time < space.scene.time.duration:
        space.compute_dynamics(space.step + 1)
    return time.perf_counter() - began


def frames_for_nobody(space: Space) -> float:
    """Hand out every frame, with its energy, momentum and fingerprint."""
    began = time.perf_counter()
    for _ in space.run():
        pass
    return time.perf_counter() - began


def recorded(space: Space, folder: str) -> tuple[float, Outcome]:
    began = time.perf_counter()
    outcome = simulate(space, Path(folder) / "run.rrd", force=True)
    return time.perf_counter() - began, outcome


def recorded_without_exact_states(space: Space, folder: str) -> float:
    """Record without fingerprints and checkpoints: such a file would be looked at, but not replayed."""
    nothing = mock.patch("carom.physics.space.fingerprint", lambda bodies, time: 0)
    never: Any = mock.patch("carom.recording.write.checkpoint_plan.CheckpointPlan.chosen", lambda plan, batch: [])
    with nothing, never:
        began = time.perf_counter()
        simulate(space, Path(folder) / "bare.rrd", force=True)
        return time.perf_counter() - began


def peak_memory(duration: float) -> float:
    """Peak resident memory in MB of a process that records so long a run."""
    code = f"import benchmarks.recording as b; b.record_once({duration})"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return float(done.stdout.strip())


def record_once(duration: float) -> None:
    with tempfile.TemporaryDirectory() as folder:
        recorded(Space(scene(duration)), folder)
    print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)


def main() -> None:
    times: dict[str, list[float]] = {"only steps": [], "frames for nobody": [], "recorded": []}
    times["without exact states"] = []
    with tempfile.TemporaryDirectory() as folder:
        recorded(Space(scene(100.0)), folder)
        for _ in range(ROUNDS):
            times["only steps"].append(only_steps(Space(scene(DURATION))))
            times["frames for nobody"].append(frames_for_nobody(Space(scene(DURATION))))
            seconds, outcome = recorded(Space(scene(DURATION)), folder)
            times["recorded"].append(seconds)
            times["without exact states"].append(recorded_without_exact_states(Space(scene(DURATION)), folder))
    medians = {name: statistics.median(values) for name, values in times.items()}
    print(f"{outcome.steps} steps, {outcome.moments.total_contacts / outcome.steps:.0f} contacts in each")
    for name, seconds in medians.items():
        print(f"{name:>20}: {seconds:.2f} s, {seconds / medians['only steps'] - 1:+.1%}")
    print(f"recorded, over frames for nobody: {medians['recorded'] / medians['frames for nobody'] - 1:+.1%}")
    exact = medians["recorded"] / medians["without exact states"] - 1
    print(f"fingerprints and checkpoints: {exact:+.1%}")
    print(f"file: {outcome.size / outcome.payload:.3f} of its payload")
    print(f"peak memory: {peak_memory(2000.0):.0f} MB for 2000 s, {peak_memory(8000.0):.0f} MB for 8000 s simulated")


if __name__ == "__main__":
    main()
