"""The data format .atoms: the number of bodies, a line of text, and for each body a word and three coordinates."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from carom.errors import SceneError
from carom.extend import Arrays, DataFormat, DataTable


def open_atoms(path: Path, called: str, snapshot: int) -> DataTable:
    """Read a file."""
    lines = path.read_text(encoding="utf-8").splitlines()
    count = int(lines[0])
    if len(lines) < count + 2:
        raise SceneError(f"{called}: the first line gives {count} bodies, but {len(lines) - 2} follow")
    rows = [line.split() for line in lines[2 : 2 + count]]
    numbers = np.array([[float(word) for word in row[1:4]] for row in rows])
    columns = {"name": np.array([row[0] for row in rows]), "x": numbers[:, 0], "y": numbers[:, 1], "z": numbers[:, 2]}
    return Arrays(columns, called)


ATOMS = DataFormat("a file of atoms", open_atoms)
