"""The figures of docs/trade.md, from the documents that `carom tradeoff` wrote.

python benchmarks/trade_figures.py                      draws them from benchmarks/results/trade/*.json into docs/
python benchmarks/trade_figures.py FOLDER…              first takes the tradeoff.json of each folder, by its name
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

from carom.experiment.work_precision.figure import draw

ROOT = Path(__file__).parent.parent
RESULTS = ROOT / "benchmarks" / "results" / "trade"


def main() -> None:
    RESULTS.mkdir(parents=True, exist_ok=True)
    for folder in map(Path, sys.argv[1:]):
        text = (folder / "tradeoff.json").read_text(encoding="utf-8")
        (RESULTS / f"{folder.name}.json").write_text(text + "\n", encoding="utf-8")
    for path in sorted(RESULTS.glob("*.json")):
        draw(json.loads(path.read_text(encoding="utf-8")), ROOT / "docs" / f"trade-{path.stem}.png")
        print(path.stem)


if __name__ == "__main__":
    main()
