"""Runs of other engines: the states that they expose, and what can be judged from these alone."""
