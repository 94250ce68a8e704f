"""The gate of `make bench`: carom's time over that of its peers, compared with the committed ratios.

    python benchmarks/gate.py [--save]

Each ratio is of CPU times on one thread, measured in turns in one process, so that a busy machine slows both sides.
`--save` writes the ratios of this machine to `results/gate.json`; another processor has others. Exits with 1 if a
ratio has grown by more than `TOLERANCE`, or `OF_RECORDING` for a recorded frame. Peers that are not installed are left
out and listed.
"""

from __future__ import annotations

import importlib
import sys
import time
from collections.abc import Callable
from typing import Any

import measurement
from measurement import processor, save, stored

TOLERANCE = 0.15  # two runs of the same code on a busy machine differ by up to a tenth
OF_RECORDING = 0.1  # least times of nine rounds differ less
NAME = "gate"

Ratios = dict[str, float]


def few_bodies(module: Any) -> Ratios:
    """Measure steps of 3 and 10 bodies beside REBOUND's leapfrog and IAS15."""
    module.COUNTS = (3, 10)
    ratios = {}
    for row in module.measure_steps(repeats=5):
        n = row["bodies"]
        ratios[f"{n} bodies, leapfrog / REBOUND"] = row["carom, leapfrog"] / row["REBOUND, leapfrog"]
        ratios[f"{n} bodies, gauss-radau15 / IAS15"] = row["carom, gauss-radau15"] / row["REBOUND, ias15"]
    return ratios


def few_contacts(module: Any) -> Ratios:
    """Measure steps of few bodies in contact, or in a medium, beside MuJoCo."""
    return {f"{row['scene']} / MuJoCo": row["µs"]["carom"] / row["µs"]["MuJoCo"] for row in module.compare(rounds=9)}


def gravity(module: Any) -> Ratios:
    """Measure the direct sum beside REBOUND's, and the tree beside pytreegrav's at its error."""
    ratios = {
        f"{row['bodies']} bodies, direct sum / REBOUND": 1.0 / row["ratio"]
        for row in module.compare_direct([1024, 4096], rounds=7)
    }
    for row in module.compare_trees([20_000], ["plummer"], ["pytreegrav"], ["tree"], rounds=5):
        ratios[f"{row['bodies']} bodies, tree / pytreegrav"] = 1.0 / row["ratio"]
    return ratios


def step(module: Any) -> Ratios:
    """Measure a step of a gas beside REBOUND and MuJoCo."""
    ratios = {}
    for row in module.compare_peers(1000, rounds=9):
        peer = "MuJoCo" if row["peer"] == "MuJoCo" else "REBOUND, tree"
        ratios[f"gas of {row['bodies']} / {peer}"] = row["ms"]["carom, 1 threads"] / row["ms"][peer]
    return ratios


def heap(module: Any) -> Ratios:
    """Measure a heap that falls and rests, beside Box3D."""
    row = module.compare(1000, threads=1, rounds=5, calm=10, only=["carom", "quick"])
    return {
        f"heap of {row['bodies']}, {name}, {state} / Box3D": row[f"ms, {state}"][name] / row[f"ms, {state}"]["Box3D"]
        for state in ("falling", "at rest")
        for name in ("carom", "quick")
    }


def recording(module: Any) -> Ratios:
    """Measure default recordings beside Rerun alone, which writes the same data."""
    ratios = {}
    for row in module.compare_writing(rounds=9):
        seconds, frames = row["s"], f"{row['frames']} frames of {row['scene']}"
        ratios[f"{frames}, encoded / Rerun"] = seconds["recorder"] / seconds["Rerun"]
        if seconds["steps"] < 0.2 * seconds["run"]:  # otherwise the difference is mostly noise
            ratios[f"{frames}, made and encoded / Rerun"] = (seconds["run"] - seconds["steps"]) / seconds["Rerun"]
    return ratios


PARTS: tuple[Callable[[Any], Ratios], ...] = (
    few_bodies,
    few_contacts,
    gravity,
    step,
    heap,
    recording,
)  # each of a benchmark of that name


def measured() -> Ratios:
    """Return the ratios of all peers that are installed."""
    ratios: Ratios = {}
    measurement.clock = time.process_time
    for part in PARTS:
        try:
            module = importlib.import_module(part.__name__)
        except ImportError as error:
            print(f"left out: {part.__name__} ({error})")
            continue
        ratios |= part(module)
    return ratios


def slower(now: Ratios, before: Ratios) -> list[str]:
    """Return the names of the ratios that have grown by more than the tolerance."""
    limits = {name: 1.0 + (OF_RECORDING if name.endswith("/ Rerun") else TOLERANCE) for name in now}
    return [name for name, ratio in now.items() if name in before and ratio > limits[name] * before[name]]


def main() -> None:
    """Measure, print a table, and judge."""
    kept = stored(NAME)
    before: Ratios = kept.get(processor(), {}).get("ratios", {})
    now = measured()
    worse = slower(now, before)
    print(f"\n{'carom / peer':48} {'committed':>9} {'now':>7} {'change':>7}")
    for name, ratio in now.items():
        then = before.get(name)
        change = f"{ratio / then - 1.0:+7.0%}" if then else f"{'new':>7}"
        print(f"{name:48} {then or float('nan'):9.3f} {ratio:7.3f} {change}{'  slower' if name in worse else ''}")
    if not before:
        print(f"no committed ratios of {processor()}, only of {', '.join(kept) or 'none'}: keep these with --save")
    if "--save" in sys.argv[1:]:
        print(save(NAME, {"ratios": {name: float(f"{ratio:.4g}") for name, ratio in now.items()}}))
    elif worse:
        sys.exit(f"slower by more than {TOLERANCE:.0%}, or {OF_RECORDING:.0%} for recordings: {', '.join(worse)}")


if __name__ == "__main__":
    main()
