"""The gain from a second worker, and the overhead of a run of a sweep.

python benchmarks/sweep.py [--runs 201]

Writes benchmarks/results/sweep.json. Rounds with one worker and with two alternate, so that
other work on the machine slows both; the median counts. The time of a sweep is from the first run of each worker to the
end of the last run; the start of the workers is reported separately. The overhead of a run is its share of that time
minus its own wall time.
"""

from __future__ import annotations

import argparse
import statistics
import tempfile
import time
from pathlib import Path

from carom.lab.sweep.manifest import SweepRun
from carom.lab.sweep.plan import plan
from carom.lab.sweep.sweep import sweep
from measurement import save

ROUNDS = 3
SCENE = """
title = "A cloud of 120 that collapses"
[time]
duration = 6.0
max_dt = 0.02
cfl = 0.1
[gravity]
constant = 1.0
[record]
every = 0.1
[[group]]
count = 120
radius = { min = 0.2, max = 0.4 }
density = 3.0
region = { shape = "ball", radius = 3.2 }
spin = { dispersion = 1.0 }
"""


class Times:
    """The times at which the runs ended."""

    def __init__(self) -> None:
        self.ends: list[float] = []

    def say(self, text: str) -> None:  # noqa: D102
        print(text)

    def begin(self, found: int) -> None:  # noqa: D102
        pass

    def ended(self, run: SweepRun) -> None:  # noqa: D102
        self.ends.append(time.perf_counter())

    def tick(self) -> None:  # noqa: D102
        pass


def measured(folder: Path, workers: int, runs: int) -> tuple[dict[str, float], dict[str, str]]:
    scene = folder / "cloud.toml"
    scene.write_text(SCENE, encoding="utf-8")
    times = Times()
    began, busy = time.perf_counter(), time.process_time()
    ending = sweep(plan(scene, seeds=runs), folder / f"{workers}-workers", times, workers=workers)
    whole = time.perf_counter() - began
    assert ending.ok
    made = ending.manifest.asked
    steady = times.ends[-1] - times.ends[workers - 1]
    each = steady * workers / (runs - workers)
    own = statistics.mean(run.wall_time or 0.0 for run in made)
    found = {
        "whole_s": whole,
        "until_first_s": times.ends[0] - began,
        "steady_s": steady,
        "runs_per_s": (runs - workers) / steady,
        "client_cpu_s": time.process_time() - busy,
        "run_s": own,
        "overhead_s": each - own,
    }
    return found, {run.name: run.fingerprint for run in made}


def median(rounds: list[dict[str, float]]) -> dict[str, float]:
    return {key: statistics.median(found[key] for found in rounds) for key in rounds[0]}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=201)
    asked = parser.parse_args()
    rounds: dict[int, list[dict[str, float]]] = {1: [], 2: []}
    for _ in range(ROUNDS):
        prints = []
        with tempfile.TemporaryDirectory() as folder:
            for workers, found in rounds.items():
                times, fingerprints = measured(Path(folder), workers, asked.runs // ROUNDS)
                found.append(times)
                prints.append(fingerprints)
        assert prints[0] == prints[1]
    one, two = median(rounds[1]), median(rounds[2])
    document = {
        "runs": asked.runs,
        "rounds": ROUNDS,
        "one_worker": one,
        "two_workers": two,
        "speedup": two["runs_per_s"] / one["runs_per_s"],
        "runs_per_s_of_rounds": {workers: [found["runs_per_s"] for found in rounds[workers]] for workers in rounds},
    }
    path = save("sweep", document)
    print(path.read_text(encoding="utf-8"))


if __name__ == "__main__":
    main()
