"""Measures how small `carom shrink` makes scenes with planted faults, and its time; writes results/shrink.json.

python benchmarks/shrink.py [PART OF A NAME]      (some minutes; kernels must be compiled)
"""

from __future__ import annotations

import json
import resource
import sys
from math import inf
from pathlib import Path
from typing import Any

from carom.errors import ExperimentError
from carom.lab.shrink.condition import condition_from
from carom.lab.shrink.reducer import Reducer
from carom.lab.shrink.shrunk_file import commented
from carom.scene.load import Scene
from patched_faults import FAULTS, Fault

RESULTS = Path(__file__).parent / "results" / "shrink.json"
BUDGET = 600.0  # s of wall time, on a machine that others use, too
CPU = 60.0  # s that a reduction should take at most


def main(part: str = "") -> None:
    """Reduce the scene of every fault whose name contains a text."""
    rows = [measured(fault) for fault in FAULTS if part in fault.name]
    for row in rows:
        print(" | ".join(str(value) for value in row.values()))
    small = [row for row in rows if row.get("bodies", 99) <= 5 and row["steps"] <= 20 and row["lines"] <= 40]
    small = [row for row in small if row["cpu_s"] <= CPU and row["only_with_the_fault"]]
    print(f"{len(small)} of {len(rows)}: at most 5 bodies, 20 steps, 40 lines and {CPU:g} s of CPU, by the fault alone")
    if not part:
        RESULTS.write_text(json.dumps(rows, indent=1, ensure_ascii=False) + "\n")


def measured(fault: Fault) -> dict[str, Any]:
    """Reduce the scene of a fault; the result must not fail without it."""
    before = cpu()
    row: dict[str, Any] = {"fault": fault.name, "condition": fault.condition}
    try:
        with fault.planted():
            result = Reducer(condition_from(fault.condition), BUDGET).reduce(Scene.from_dict(fault.scene))
    except ExperimentError as error:
        return row | {"refused": str(error)}
    lines = len(commented(result.document, []).strip().splitlines())
    row |= {"bodies": result.bodies, "steps": result.steps, "lines": lines, "candidates": result.candidates}
    row |= {"wall_s": round(result.seconds, 1), "cpu_s": round(cpu() - before, 1), "stopped": result.stopped}
    row["only_with_the_fault"] = not shows_without(fault, result.document)
    print(json.dumps(row, ensure_ascii=False), flush=True)
    if "-v" in sys.argv:
        print(commented(result.document, []))
    return row


def shows_without(fault: Fault, document: dict[str, Any]) -> bool:
    """Return whether a reduced scene also fails without the fault."""
    try:
        Reducer(condition_from(fault.condition), inf).reduce(Scene.from_dict(document))
    except ExperimentError:
        return False
    return True


def cpu() -> float:
    """CPU time of this process in s."""
    used = resource.getrusage(resource.RUSAGE_SELF)
    return used.ru_utime + used.ru_stime


if __name__ == "__main__":
    main(*[text for text in sys.argv[1:2] if not text.startswith("-")])
