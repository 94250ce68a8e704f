"""The figures and tables of docs/trade.md, from the documents that `carom tradeoff` wrote.

    python benchmarks/trade_figures.py              from benchmarks/results/trade/*.json into docs/
    python benchmarks/trade_figures.py FOLDER…      first takes the tradeoff.json of each folder, by its name

A table has the scene as written, and all settings that are or may be on the front of position or energy. It replaces
the one between the comments `<!-- table: NAME -->` and `<!-- end -->`.
"""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path
from typing import Any

from carom.lab.tradeoff.study_document import VERSION
from carom.lab.tradeoff.tradeoff_figure import draw
from carom.scene.units.dimension import TIME
from carom.scene.units.system import SI

ROOT = Path(__file__).parent.parent
RESULTS = ROOT / "benchmarks" / "results" / "trade"
PAGE = ROOT / "docs" / "trade.md"
ERRORS = {"position": "position", "energy": "energy", "overlap": "overlap"}
FRONTS = ("position", "energy")
BUSY = 3.0  # load average from which costs count as loaded: a study itself makes 1, and its machine has two cores


def main() -> None:
    """Draw the figures and write the tables."""
    RESULTS.mkdir(parents=True, exist_ok=True)
    for folder in map(Path, sys.argv[1:]):
        text = (folder / "tradeoff.json").read_text(encoding="utf-8")
        (RESULTS / f"{folder.name}.json").write_text(text + "\n", encoding="utf-8")
    page = PAGE.read_text(encoding="utf-8")
    for path in sorted(RESULTS.glob("*.json")):
        document = json.loads(path.read_text(encoding="utf-8"))
        if document["version"] != VERSION:
            print(f"{path.stem}: kept as it is, since another version of carom measured it")
            continue
        draw(document, ROOT / "docs" / f"trade-{path.stem}.png")
        place = re.compile(rf"(<!-- table: {path.stem} -->\n).*?(<!-- end -->)", re.DOTALL)
        lines = table(document)
        page, found = place.subn(lambda match: f"{match[1]}{lines}\n{match[2]}", page)  # noqa: B023
        print(f"{path.stem}{'' if found else ': docs/trade.md has no place for its table'}")
    PAGE.write_text(page, encoding="utf-8")


def table(document: dict[str, Any]) -> str:
    """Return the table of a study, the cheapest setting first, and a note on all of its rows."""
    measured = [entry for entry in document["settings"] if entry["status"] == "measured" and entry["cost"]]
    shown = [entry for entry in measured if entry["name"] == "as written" or any(map(entry["marks"].get, FRONTS))]
    rows = [f"| setting | cost, s | steps | {' | '.join(ERRORS.values())} |", "|---" * (3 + len(ERRORS)) + "|"]
    for entry in sorted(shown, key=lambda entry: entry["cost"]):
        cells = [entry["name"], f"{entry['cost']:.2g}", str(entry["steps"]), *(_error(entry, each) for each in ERRORS)]
        rows.append(f"| {' | '.join(cells)} |")
    return "\n".join([*rows, "", _below(document, len(measured) - len(shown))])


def _error(entry: dict[str, Any], error: str) -> str:
    value = entry["errors"][error]
    if value is None:
        return "–"
    text = f"{value:.1e}" if value else "0"
    return f"**{text}**" if entry["marks"][error] == "front" else text


def _below(document: dict[str, Any], hidden: int) -> str:
    """Describe the omitted settings, the uncertainty of the reference, and the noise of the costs."""
    reference, load = document["reference"], document.get("load", 0.0)
    ended = [f"{e['name']} {e['reason']}" for e in document["settings"] if e["status"] in ("stopped", "failed")]
    horizon, end = (SI.text(reference[key], TIME) for key in ("horizon", "duration"))
    parts = [
        f"Bold: on the front; {hidden} other settings are beaten in both" if hidden else "Bold: on the front",
        f"positions compared up to {horizon} of {end}, sure to {reference['uncertainty']['position']:.1e}",
        f"noise of the costs {document['noise']:.0%}" + (f", *loaded* (load {load:.0f})" if load > BUSY else ""),
        *ended,
    ]
    return "; ".join(parts) + "."


if __name__ == "__main__":
    main()
