"""Writes chute-bed.csv, the centres of the fixed balls of chute.toml: a square lattice, displaced at random, in metres.

python configs/chute-bed.py
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

ALONG, ACROSS = 10, 5  # balls along the flow and across it
DIAMETER = 0.02  # m, of the balls that flow; the lattice is as wide
DISPLACEMENT = (0.1, 0.1, 0.2)  # largest, in diameters

if __name__ == "__main__":
    random = np.random.default_rng(1)
    lattice = [(i - (ALONG - 1) / 2, j - (ACROSS - 1) / 2, 0.0) for i in range(ALONG) for j in range(ACROSS)]
    rows = DIAMETER * (np.array(lattice) + random.uniform(-1.0, 1.0, (ALONG * ACROSS, 3)) * DISPLACEMENT)
    np.savetxt(Path(__file__).with_suffix(".csv"), rows, "%.5f", ",", header="x,y,z", comments="")
