"""The timelines of a recording."""

STEP = "step"  # a count
SIM_TIME = "sim_time"  # a duration in ns, scaled: see `Clock`
IMPACT = "impact"  # a count, from 1 on: rows of impacts, and of the bodies at the moments of some of them
