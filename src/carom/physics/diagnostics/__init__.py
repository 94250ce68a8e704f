"""Diagnostics of a run: energy, momentum, extremes, activity, fingerprints, and a profile of its time."""
