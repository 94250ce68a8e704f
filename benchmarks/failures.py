"""Prints the times of `carom why` and `carom fork`, and the λ of fork and diff, which should agree.

python benchmarks/failures.py      (one or two minutes on two quiet cores; kernels must be compiled)
"""

from __future__ import annotations

import tempfile
import time
from pathlib import Path

import numpy as np

from carom.lab.fork.branch import Branch, results_of, start_of
from carom.lab.fork.fork import ensemble, fork
from carom.lab.why.history import question_of
from carom.lab.why.why import why
from carom.physics.jit import cores
from carom.recording.read.recording import Recording
from carom.runs.run import run
from carom.runs.workers import LocalWorkers
from carom.scene.load import load_scene

SPHERES = Path(__file__).parent / "scenes" / "thousand-spheres.toml"
SEEDS = 200
AT = 0.01  # s, of the fork


def main() -> None:
    """Measure both in a temporary folder."""
    with tempfile.TemporaryDirectory() as folder:
        _why(Path(folder))
        _fork(Path(folder))


def _why(folder: Path) -> None:
    run(load_scene("cloud-collapse", []), folder / "cloud.rrd")
    began = time.perf_counter()
    recording = Recording.open(folder / "cloud.rrd")
    answer = why(recording, question_of(recording, None, None, "impact"))
    took = time.perf_counter() - began
    print(f"why cloud-collapse --event impact: {took:.2f} s; {len(answer.bodies)} bodies in the cone")
    print(f"  unexplained: {max(account.unexplained for account in answer.accounts):.1e} of the largest speed")


def _fork(folder: Path) -> None:
    run(load_scene(SPHERES, []), folder / "spheres.rrd")
    branch = Branch(folder / "spheres.rrd", AT)
    began = time.perf_counter()
    start = start_of(branch)
    with LocalWorkers(cores()) as workers:
        found = ensemble(start, branch, SEEDS, 1, lambda tasks: results_of(tasks, workers))
    print(f"fork of 1000 spheres, {SEEDS} seeds: {time.perf_counter() - began:.1f} s")
    print(f"  λ = {np.median(found.rates):.3g} ± {found.rate_error:.2g} /s")
    single = fork(start, folder / "one.rrd", 1, 1)[1].divergence
    if single is not None:
        print(f"  λ of carom diff, one fork: {single.rate:.3g} ± {single.standard_error:.2g} /s")


if __name__ == "__main__":
    main()
