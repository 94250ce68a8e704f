"""The two timelines of a recording."""

STEP = "step"  # a count
SIM_TIME = "sim_time"  # a duration in ns, scaled: see `Clock`
