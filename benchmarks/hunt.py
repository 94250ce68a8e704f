"""Measures how soon `carom hunt` finds planted faults; writes results/hunt.json.

python benchmarks/hunt.py [PART OF A NAME]      (some minutes; kernels must be compiled)

Each fault gets 300 s of CPU time of one core. All scenes have the same seed. Laws that they break without
a fault, if any, do not count as finds.
"""

from __future__ import annotations

import json
import resource
import sys
from functools import cache
from math import inf
from pathlib import Path
from typing import Any

from carom.lab.hunt.hunt import Hunt
from carom.lab.shrink.trials import Budget
from carom.runs.environment import Interrupts
from patched_faults import FAULTS, Fault

RESULTS = Path(__file__).parent / "results" / "hunt.json"
SEED = 20
CPU = 300.0  # s for each fault
SILENT = Budget(inf, Interrupts())


def main(part: str = "") -> None:
    """Hunt for every fault whose name contains a text."""
    rows = [measured(fault) for fault in FAULTS if part in fault.name]
    found = sum(bool(row["law"]) for row in rows)
    print(f"{found} of {len(rows)} faults found within {CPU:g} s of CPU")
    if not part:
        RESULTS.write_text(json.dumps(rows, indent=1, ensure_ascii=False) + "\n")


def measured(fault: Fault) -> dict[str, Any]:
    """Hunt with a fault until it breaks a law that holds without it."""
    hunt, began, index, found = Hunt(SEED, Path("never")), cpu(), 0, list[str]()
    elsewhere = 0.0  # s, spent on runs without the fault
    while not found and cpu() - began - elsewhere < CPU:
        with fault.planted():
            found = [finding.law.name for finding in hunt.judge(index, SILENT)]
        if found:
            before = cpu()
            found = [law for law in found if law not in sound(index)]
            elsewhere += cpu() - before
        index += 1
    row = {"fault": fault.name, "law": ", ".join(found), "scenes": index, "cpu_s": round(cpu() - began - elsewhere, 1)}
    print(json.dumps(row, ensure_ascii=False), flush=True)
    return row


@cache
def sound(index: int) -> list[str]:
    """Return the laws that a scene breaks without a fault."""
    return [finding.law.name for finding in Hunt(SEED, Path("never")).judge(index, SILENT)]


def cpu() -> float:
    """CPU time of this process in s."""
    used = resource.getrusage(resource.RUSAGE_SELF)
    return used.ru_utime + used.ru_stime


if __name__ == "__main__":
    main(*sys.argv[1:2])
