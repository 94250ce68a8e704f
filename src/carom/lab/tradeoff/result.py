"""A setting of a study with what was measured of it."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from statistics import median

from carom.lab.tradeoff.error_measures import Errors
from carom.lab.tradeoff.settings_grid import Setting


@dataclass
class Result:
    """A setting and its measurements so far."""

    setting: Setting
    status: str = "pending"  # "measured", "refused", "stopped" or "failed"
    reason: str = ""  # why it was refused, stopped or failed
    costs: list[float] = field(default_factory=list)  # s, of each run
    steps: int = 0
    frames: int = 0  # in a recording of it
    errors: Errors | None = None
    spent: float = 0.0  # s of CPU time, after which it was stopped

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
