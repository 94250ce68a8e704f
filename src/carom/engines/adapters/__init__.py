"""A module for each engine: its source for the recorder, and the engine that `carom crosscheck` runs."""
