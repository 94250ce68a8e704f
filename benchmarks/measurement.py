"""Common parts of the benchmarks: interleaved rounds, a description of the machine, and files for the results.

A file keeps the results of each processor, by its name.
"""

from __future__ import annotations

import importlib.metadata
import json
import platform
import re
import statistics
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from carom.physics.jit import cores
from carom.runs.environment import environment

RESULTS = Path(__file__).parent / "results"
ZEN_3 = 0x19  # family of AMD's processors of the third and fourth generation; the fifth is the next one
clock = time.perf_counter  # used by `medians`; the gate replaces it by CPU time, since it compares single threads


def medians(
    contenders: Mapping[str, Callable[[], object]], rounds: int, budget: float = 60.0, cold: int = 1
) -> dict[str, float]:
    """Return the median seconds of each contender, called in turn, round after round.

    The first ``cold`` rounds, in which kernels and caches warm up, do not count. Another process or a hot processor
    slows all contenders equally. After ``budget`` seconds no further round begins.
    """
    spent: dict[str, list[float]] = {name: [] for name in contenders}
    began = time.perf_counter()
    for number in range(1 - cold, rounds + 1):
        for name, contender in contenders.items():
            start = clock()
            contender()
            if number > 0:
                spent[name].append(clock() - start)
        if number > 0 and time.perf_counter() - began > budget:
            break
    return {name: statistics.median(times) for name, times in spent.items()}


def forget_peak() -> None:
    """Reset the peak memory of this process; Linux only."""
    Path("/proc/self/clear_refs").write_text("5", encoding="ascii")


def peak_megabytes() -> int:
    """Return the peak memory of this process since the last reset, in MB."""
    status = Path("/proc/self/status").read_text(encoding="utf-8")
    return int(status.partition("VmHWM:")[2].split()[0]) // 1024


def merge(name: str, results: dict[str, list[dict[str, Any]]], *peers: str) -> Path:
    """Add rows to the results of this processor; a row replaces the row of the same case.

    The texts and whole numbers of a row identify its case; all other values are measurements.
    """
    known = stored(name).get(processor(), {})
    known.pop("about", None)
    for part, rows in results.items():
        fresh = {_subject(row) for row in rows}
        known[part] = [row for row in known.get(part, []) if _subject(row) not in fresh] + rows
    return save(name, known, *peers)


def _subject(row: dict[str, Any]) -> tuple[tuple[str, str | int], ...]:
    return tuple(sorted((key, value) for key, value in row.items() if isinstance(value, str | int)))


def processor() -> str:
    """Return a short name of the processor, such as "AMD Zen 4 (AVX-512)"."""
    path = Path("/proc/cpuinfo")
    first = path.read_text(encoding="utf-8").partition("\n\n")[0] if path.exists() else ""
    facts = dict(re.findall(r"^([\w ]+?)\s*: (.*)$", first, re.MULTILINE))
    return processor_of(facts) if "model name" in facts else platform.processor() or platform.machine()


def processor_of(facts: dict[str, str]) -> str:
    """Return the name of a processor that /proc/cpuinfo describes."""
    name = re.sub(r"\((R|TM)\)|\b(CPU|Processor)\b.*", "", facts["model name"])
    family, model = int(facts.get("cpu family", "0")), int(facts.get("model", "0"))
    if facts.get("vendor_id") == "AuthenticAMD" and (family, model) >= (ZEN_3, 0):
        is_zen_4 = 0x10 <= model < 0x20 or 0x60 <= model < 0xB0
        name = "AMD Zen " + ("5" if family > ZEN_3 else "4" if is_zen_4 else "3")
    return " ".join(name.split()) + (" (AVX-512)" if "avx512f" in facts.get("flags", "").split() else "")


def stored(name: str) -> dict[str, dict[str, Any]]:
    """Return the results in a file, by processor."""
    path = RESULTS / f"{name}.json"
    document: dict[str, dict[str, Any]] = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
    return document


def save(name: str, results: dict[str, Any], *peers: str) -> Path:
    """Keep results of this processor, with a description of the machine and the versions of carom and its peers."""
    about = {key: value for key, value in environment(cores()).items() if key != "command"}
    about["cores"] = about.pop("threads")
    about |= {f"version.{peer}": importlib.metadata.version(peer) for peer in peers}
    about["date"] = time.strftime("%Y-%m-%d")
    RESULTS.mkdir(exist_ok=True)
    path = RESULTS / f"{name}.json"
    document = stored(name) | {processor(): {"about": about | {"platform": platform.platform()}, **results}}
    path.write_text(json.dumps(document, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    return path
