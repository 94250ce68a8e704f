"""Extended XYZ, which OVITO and ASE read: a text block per step, with named columns and lengths in metres."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import repeat
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from carom.scene.portable_math import ENDLESS

if TYPE_CHECKING:
    from carom.recording.export import Snapshot


# OVITO's names of the quantities
_COLUMNS = {"position": "pos", "velocity": "velo", "orientation": "orientation", "angular_velocity": "omega"}


def write_extended_xyz(path: Path, first: Snapshot, others: Iterator[Snapshot]) -> None:
    """Write all steps into one file."""
    with path.open("w", encoding="utf-8") as file:
        for snapshot in (first, *others):
            columns = [("pos", snapshot.vectors["position"]), ("radius", snapshot.radius[:, None])]
            columns += [("mass", snapshot.mass[:, None])]
            columns += [
                (_COLUMNS.get(name, name), values) for name, values in snapshot.vectors.items() if name != "position"
            ]
            kinds = "".join(f":{name}:R:{values.shape[1]}" for name, values in columns)
            names = [f" {'_'.join(str(name).split())}" for name in snapshot.others.get("name", ())]
            kinds += ":name:S:1" if names else ""
            energies = " ".join(f"energy_{name}={value!r}" for name, value in snapshot.energies.items())
            head = f"Properties=species:S:1:id:I:1{kinds} Time={snapshot.time!r} Step={snapshot.step} {energies}"
            rows = np.concatenate([values for _, values in columns], axis=1).tolist()
            lines = [
                f"X {body} {' '.join(map(repr, row))}{name}"
                for body, row, name in zip(snapshot.body.tolist(), rows, names or repeat(""), strict=False)
            ]
            file.write("\n".join([str(len(rows)), f"{head} {_cell(snapshot)}", *lines, ""]))


def _cell(snapshot: Snapshot) -> str:
    """State the vectors of the periodic box, if there is one, and its lower corner, for OVITO."""
    if snapshot.cell is None:
        return 'pbc="F F F"'
    if snapshot.cell.ndim == 2:  # the box is sheared
        vectors, corner = (" ".join(map(repr, v.ravel().tolist())) for v in (snapshot.cell, -snapshot.cell.sum(0) / 2))
        return f'Lattice="{vectors}" Origin="{corner}" pbc="T T T"'
    box = snapshot.cell.tolist()
    repeats = [length < ENDLESS for length in box]
    x, y, z = (length if one else 0.0 for length, one in zip(box, repeats, strict=True))
    corner = " ".join(repr(0.0 - length / 2.0) for length in (x, y, z))
    flags = " ".join("T" if one else "F" for one in repeats)
    return f'Lattice="{x!r} 0 0 0 {y!r} 0 0 0 {z!r}" Origin="{corner}" pbc="{flags}"'
