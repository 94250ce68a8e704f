"""NumPy's .npz: arrays with the steps first."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from carom.recording.export.export import Snapshot


def write_npz(path: Path, first: Snapshot, others: Iterator[Snapshot]) -> None:
    """Write step and time (K,), values such as body and mass (n,), and vectors such as position (K, n, 3 or 4)."""
    every = [first, *others]
    stacked: dict[str, Any] = {name: np.stack([each.vectors[name] for each in every]) for name in first.vectors}
    step, time = np.array([each.step for each in every]), np.array([each.time for each in every])
    own = {"body": first.body, "mass": first.mass, "radius": first.radius, **first.others}
    with path.open("wb") as file:  # given a name, NumPy would append .npz
        np.savez(file, **{"step": step, "time": time, **own, **stacked})
