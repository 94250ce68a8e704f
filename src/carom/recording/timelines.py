"""The timelines of a recording."""

from __future__ import annotations

STEP = "step"  # a count
SIM_TIME = "sim_time"  # a duration in ns, scaled: see `TimeScale`
IMPACT = "impact"  # a count, from 1 on: rows of impacts, and the states at some of them
