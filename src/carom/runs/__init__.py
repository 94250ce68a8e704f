"""Runs: from a scene to a recording, and again from a recording."""
