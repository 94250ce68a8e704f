"""The recordings that most tests here read."""

from recorded_runs import recorded, run_file, scripted

__all__ = ["recorded", "run_file", "scripted"]
