"""Draw docs/performance-*.png from benchmarks/results, without measuring anything.

python benchmarks/performance.py
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt

from measurement import stored

DOCS = Path(__file__).parent.parent / "docs"
PROCESSOR = "AMD Zen 5 (AVX-512)"  # whose results are drawn
BOUND = 2.69e9  # pairs/s: one square root and one division each, on a core of the machine of the results


def results(name: str) -> dict[str, Any]:
    """Read the results that a benchmark saved."""
    return stored(name)[PROCESSOR]


def gravity() -> None:
    """Time of an evaluation of gravity over the number of bodies, beside the peers and the bound."""
    found = results("gravity")
    direct = found["direct"]
    n = [row["bodies"] for row in direct]
    figure, axes = plt.subplots(figsize=(7, 4.5), layout="constrained")
    axes.loglog(n, [row["seconds"]["REBOUND"] for row in direct], "s--", color="tab:red", label="REBOUND, direct")
    axes.loglog(n, [row["seconds"]["carom"] for row in direct], "o-", color="tab:blue", label="carom, direct")
    axes.loglog(n, [k * k / BOUND for k in n], ":", color="black", label="bound: a root and a division a directed pair")
    styles = {"pytreegrav": ("^--", "tab:orange"), "REBOUND": ("v--", "tab:purple")}
    for peer, (style, colour) in styles.items():
        rows = [
            row
            for row in found["tree"]
            if row["method"] == "tree" and row["peer"].startswith(peer) and row["shape"] == "plummer"
        ]
        sizes = [row["bodies"] for row in rows]
        axes.loglog(sizes, [row["seconds"]["peer"] for row in rows], style, color=colour, label=f"{peer}, tree")
        own = [row["seconds"]["carom"] for row in rows]
        axes.loglog(sizes, own, style[0] + "-", color="tab:green", label=f"carom, tree, at {peer}'s error")
    axes.set(xlabel="bodies", ylabel="s an evaluation, one thread")
    axes.legend(fontsize=8, loc="lower right")
    axes.grid(alpha=0.3)
    figure.savefig(DOCS / "performance-gravity.png", dpi=120)


def steps() -> None:
    """Time and memory of a whole step over the number of bodies."""
    figure, (left, right) = plt.subplots(1, 2, figsize=(9, 4), layout="constrained")
    names = (("scaling", "contacts", "tab:blue"), ("gravity-step", "tree and contacts", "tab:green"))
    for name, label, colour in names:
        rows = results(name)["rows"]
        n = [row["bodies"] for row in rows]
        for threads, style in (("1 threads", "--"), ("2 threads", "-")):
            times = [row["ms"][threads] * 1e-3 for row in rows]
            left.loglog(
                n, times, style, marker="o", color=colour, label=f"{label}, {threads.replace('1 threads', '1 thread')}"
            )
        right.loglog(n, [row["peak_megabytes"] for row in rows], "o-", color=colour, label=label)
    left.set(xlabel="bodies", ylabel="s a step")
    right.set(xlabel="bodies", ylabel="peak memory of the process, MB")
    for axes in (left, right):
        axes.legend(fontsize=8)
        axes.grid(alpha=0.3)
    figure.savefig(DOCS / "performance-steps.png", dpi=120)


if __name__ == "__main__":
    gravity()
    steps()
