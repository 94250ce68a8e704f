"""Cost over error of every setting of every engine, in one figure: a heap, a gas, billiards, planets, a pile in a wind.

    python benchmarks/front.py                        all scenes, with every engine that is installed and can run them
    python benchmarks/front.py heap billiards         some of them
    python benchmarks/front.py --budget 60 planets    the seconds of each study (default: that of `carom tradeoff`)

Studies are those of `carom tradeoff --threads 1`, one folder a scene in recordings/front. What is measured stays; the
same command continues, and draws recordings/front/front.png, .svg and .pdf with front.csv beside them. Costs mean
something on a machine that does nothing else.
"""

from __future__ import annotations

import argparse
import csv
import json
import subprocess
import sys
from collections import defaultdict
from pathlib import Path
from typing import Any

from carom import registry
from carom.lab.figure_style import styled
from carom.lab.tradeoff.tradeoff_figure import COLOURS, LEAST

ROOT = Path(__file__).parent.parent
FOLDER = ROOT / "recordings" / "front"
PEERS = ROOT / "benchmarks" / "scenes"
# the scene, and the error that tells engines apart; trajectories of heaps and piles diverge within their first fall
SCENES = {
    "heap": ("heap", "overlap"),
    "gas": ("elastic-gas", "position"),
    "billiards": ("billiards", "position"),
    "planets": (str(PEERS / "planetary-system.toml"), "position"),
    "pile-in-a-wind": (str(PEERS / "pile-in-a-wind.toml"), "overlap"),
}
OWN = "carom"


def measure(name: str, budget: list[str]) -> dict[str, Any]:
    """Measure carom's settings, then those of each engine; return the document of the study."""
    scene, _ = SCENES[name]
    command = [sys.executable, "-m", "carom", "tradeoff", scene, "-o", str(FOLDER / name), "--threads", "1", *budget]
    subprocess.run(command, stdout=subprocess.DEVNULL, check=True)
    for engine in registry.names("engines"):
        done = subprocess.run(
            [*command, "--engine", engine], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, check=False
        )
        if done.returncode:
            print(f"{name}: {engine} is left out: {done.stderr.strip().splitlines()[-1]}")
    document: dict[str, Any] = json.loads((FOLDER / name / "tradeoff.json").read_text(encoding="utf-8"))
    return document


def rows_of(name: str, document: dict[str, Any]) -> list[dict[str, Any]]:
    """Return a row for each timed setting of a study, by engine and cost."""
    _, error = SCENES[name]
    timed = [entry for entry in document["settings"] if entry["cost"] and entry["errors"] and not entry["same_as"]]
    rows = [
        {
            "scene": name,
            "engine": entry["engine"] or OWN,
            "setting": entry["name"],
            "cost": entry["cost"],
            "spread": entry["spread"],
            "error": error,
            "value": entry["errors"][error],
        }
        for entry in timed
        if entry["errors"][error] is not None
    ]
    return sorted(rows, key=lambda row: (row["engine"], row["cost"]))


def draw(found: dict[str, list[dict[str, Any]]]) -> None:
    """Draw a panel for each scene: an engine's settings in one colour, and zeros on the lowest line."""
    with styled(8):
        from matplotlib.figure import Figure  # noqa: PLC0415 - an extra

        figure = Figure(figsize=(4.2 * len(found), 3.8), layout="constrained", dpi=110)
        axes = figure.subplots(1, len(found), squeeze=False)[0]
        engines = sorted(
            {row["engine"] for rows in found.values() for row in rows}, key=lambda name: (name != OWN, name)
        )
        colour = {engine: COLOURS[k % len(COLOURS)] for k, engine in enumerate(engines)}
        shown = dict[str, Any]()
        for ax, (name, rows) in zip(axes, found.items(), strict=True):
            by_engine: dict[str, list[tuple[float, float]]] = defaultdict(list)
            for row in rows:
                by_engine[row["engine"]].append((row["cost"], max(row["value"], LEAST)))
            for engine, points in by_engine.items():
                cost, value = zip(*points, strict=True)
                marker = "o" if engine == OWN else "D"
                shown[engine] = ax.scatter(cost, value, s=22, color=colour[engine], marker=marker, label=engine)
            ax.set(xscale="log", yscale="log", title=name, xlabel="CPU time of a run, s", ylabel=SCENES[name][1])
            ax.grid(visible=True, alpha=0.3)
        figure.legend(shown.values(), shown.keys(), loc="outside lower center", ncols=len(shown), frameon=False)
        for ending in ("png", "svg", "pdf"):
            figure.savefig(FOLDER / f"front.{ending}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", nargs="*", metavar="SCENE", help=f"some of {', '.join(SCENES)}; default: all")
    parser.add_argument("--budget", metavar="SECONDS", help="of each study")
    given = parser.parse_args()
    if unknown := set(given.scenes) - set(SCENES):
        parser.error(f"{', '.join(sorted(unknown))}: choose among {', '.join(SCENES)}")
    FOLDER.mkdir(parents=True, exist_ok=True)
    budget = ["--budget", given.budget] if given.budget else []
    found = {name: rows_of(name, measure(name, budget)) for name in given.scenes or SCENES}
    rows = [row for each in found.values() for row in each]
    with (FOLDER / "front.csv").open("w", encoding="utf-8", newline="") as file:
        table = csv.DictWriter(file, list(rows[0]) if rows else [])
        table.writeheader()
        table.writerows(rows)
    draw(found)
    print(FOLDER / "front.png", FOLDER / "front.csv")


if __name__ == "__main__":
    main()
