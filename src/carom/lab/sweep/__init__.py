"""Sweeps: many runs of one scene with varied values and seeds."""
