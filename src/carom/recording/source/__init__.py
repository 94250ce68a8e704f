"""Runs of other engines: what they show of their state, and what can be judged from that alone."""
