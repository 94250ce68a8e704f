"""NumPy's .npz: arrays with the steps first."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from carom.recording.export import Snapshot


def write_npz(path: Path, first: Snapshot, others: Iterator[Snapshot]) -> None:
    """Write step and time (K,), values such as body and mass (n,), and vectors such as position (K, n, 3 or 4).

    Where bodies come and go, n counts all of them; vectors of a body that does not exist are NaN.
    """
    every = [first, *others]
    body, rows = np.unique(np.concatenate([each.body for each in every]), return_index=True)
    stacked: dict[str, Any] = {}
    for name, like in first.vectors.items():
        stacked[name] = np.full((len(every), len(body), like.shape[1]), np.nan)
        for found, each in zip(stacked[name], every, strict=True):
            found[np.searchsorted(body, each.body)] = each.vectors[name]
    step, time = np.array([each.step for each in every]), np.array([each.time for each in every])
    values = {"mass": [each.mass for each in every], "radius": [each.radius for each in every]}
    values |= {name: [each.others[name] for each in every] for name in first.others}
    own = {"body": body, **{name: np.concatenate(arrays)[rows] for name, arrays in values.items()}}
    with path.open("wb") as file:  # given a name, NumPy would append .npz
        np.savez(file, **{"step": step, "time": time, **own, **stacked})
