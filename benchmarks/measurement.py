"""What benchmarks share: interleaved rounds, the machine they ran on, and a file for the numbers."""

from __future__ import annotations

import importlib.metadata
import json
import platform
import statistics
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from carom.experiment.environment import environment
from carom.physics.team import cores

RESULTS = Path(__file__).parent / "results"


def medians(contenders: dict[str, Callable[[], object]], rounds: int, budget: float = 60.0) -> dict[str, float]:
    """Return the median seconds of each contender, called in turn, round after round.

    A first round, in which kernels and caches warm up, does not count. Another process or a hot processor slows all
    alike. After ``budget`` seconds no further round begins.
    """
    spent: dict[str, list[float]] = {name: [] for name in contenders}
    began = time.perf_counter()
    for number in range(rounds + 1):
        for name, contender in contenders.items():
            start = time.perf_counter()
            contender()
            if number > 0:
                spent[name].append(time.perf_counter() - start)
        if number > 0 and time.perf_counter() - began > budget:
            break
    return {name: statistics.median(times) for name, times in spent.items()}


def save(name: str, results: dict[str, Any], *peers: str) -> Path:
    """Write results with the machine and the versions, those of the peers, too."""
    about = {key: value for key, value in environment(cores()).items() if key != "command"}
    about["cores"] = about.pop("threads")
    about |= {f"version.{peer}": importlib.metadata.version(peer) for peer in peers}
    about["date"] = time.strftime("%Y-%m-%d")
    RESULTS.mkdir(exist_ok=True)
    path = RESULTS / f"{name}.json"
    document = {"about": about | {"platform": platform.platform()}, **results}
    path.write_text(json.dumps(document, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    return path
