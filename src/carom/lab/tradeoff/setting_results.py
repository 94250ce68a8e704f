"""Settings with their measurements, as entries of ``tradeoff.json``, and the Pareto front of cost and error.

A setting is on the front if no other setting beats it in both cost and error. Errors are the same in every run. Costs
are noisy, so each is an interval. A setting is beaten if another one has no larger error and its cost interval lies
entirely below. It is on the front if the cost intervals of all others with no larger error lie entirely above.
Otherwise it is undecided. Two measurements whose intervals overlap for each setting therefore never contradict each
other: no setting is on the front in one and beaten in the other. A front of medians would change with every measurement
of settings with equal costs. Errors that differ by less than the uncertainty of the reference are not distinguished,
unless they are equal.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, field
from statistics import median
from typing import Any

import numpy as np

from carom import Scene
from carom.arrays import BoolArray, FloatArray
from carom.extend import finite
from carom.lab.compared_run import Setting, Trajectory
from carom.lab.tradeoff.reference import NAMES, Errors, Reference, scale_of


@dataclass
class SettingResult:
    """A setting and its measurements so far."""

    setting: Setting
    status: str = "pending"  # "measured", "refused", "stopped" or "failed"
    reason: str = ""  # why it was refused, stopped or failed
    costs: list[float] = field(default_factory=list)  # s, of each run
    steps: int = 0
    frames: int = 0  # in a recording of it
    errors: Errors | None = None
    spent: float = 0.0  # s of CPU time at which it was stopped

    @property
    def cost(self) -> float:
        """Median cost in s; NaN if there is none."""
        return median(self.costs) if self.costs else math.nan

    @property
    def spread(self) -> float:
        """Half the range of the costs over their median; 0 for a single one."""
        return (max(self.costs) - min(self.costs)) / 2 / self.cost if self.costs else 0.0

    @property
    def complete(self) -> bool:
        """Whether it has both an error and a cost."""
        return bool(self.costs) and self.errors is not None


def result_entry(result: SettingResult) -> dict[str, Any]:
    """Return the results of one setting."""
    return {
        "name": result.setting.name,
        "overrides": list(result.setting.overrides),
        "threads": result.setting.threads,
        "engine": result.setting.engine,
        "status": result.status,
        "reason": result.reason,
        "steps": result.steps,
        "frames": result.frames,
        "costs": result.costs,
        "spent": result.spent,
        "cost": finite(result.cost),
        "spread": result.spread,
        "errors": result.errors and finite(asdict(result.errors)),
    }


def result_of(entry: dict[str, Any]) -> SettingResult:
    """Read the results of one setting, without its errors."""
    overrides = tuple(entry["overrides"])
    setting = Setting(entry["name"], overrides, entry.get("threads"), entry.get("engine", ""))
    result = SettingResult(setting, entry["status"], entry["reason"], entry["costs"], entry["steps"], entry["frames"])
    result.spent = entry.get("spent", 0.0)
    return result


def reference_entry(reference: Reference) -> dict[str, Any]:
    """Return a reference without its trajectory."""
    return {
        "kind": reference.kind,
        "text": reference.text,
        "fineness": finite(reference.fineness),
        "samples": reference.samples,
        "horizon": reference.horizon,
        "duration": float(reference.trajectory.time[-1]),
        "whole": reference.whole,
        "complete": reference.is_complete,
        "uncertainty": finite(asdict(reference.uncertainty)),
    }


def reference_of(entry: dict[str, Any], scene: Scene, trajectory: Trajectory) -> Reference:
    """Read a reference; its trajectory is given."""
    return Reference(
        trajectory,
        scale_of(scene, trajectory),
        entry["kind"],
        math.inf if entry["fineness"] is None else entry["fineness"],
        entry["samples"],
        entry["whole"],
        Errors(**{e: math.nan if entry["uncertainty"][e] is None else entry["uncertainty"][e] for e in NAMES}),
        entry["text"],
    )


def pareto_front(
    cost: FloatArray, error: FloatArray, noise: FloatArray, doubt: float = 0.0
) -> tuple[BoolArray, BoolArray]:
    """Mark the points on the front, and the undecided ones.

    Parameters
    ----------
    cost, error
        (m,) each; a point with a NaN in either is never marked and beats nothing.
    noise
        (m,) relative noise: the true cost lies between cost / (1 + noise) and cost (1 + noise).
    doubt
        Uncertainty of the errors; unequal errors that differ by less are not distinguished.

    Returns
    -------
    on, near
        (m,) each; no point is both.
    """
    known = ~np.isnan(cost + error)
    low, high = cost / (1.0 + noise), cost * (1.0 + noise)
    one, other = error[:, None], error[None, :]  # [j, k]: j beside k
    better = one + doubt < other
    no_worse = better | (one + doubt == other) | (one == other)
    rivals = known[:, None] & ~np.eye(len(cost), dtype=bool)
    below = (high[:, None] < low[None, :]) | (better & (high[:, None] <= low[None, :]))
    beaten = np.any(rivals & no_worse & below, axis=0)
    in_doubt = np.any(rivals & (one <= other + doubt) & (low[:, None] < high[None, :]), axis=0)
    return known & ~beaten & ~in_doubt, known & ~beaten & in_doubt
