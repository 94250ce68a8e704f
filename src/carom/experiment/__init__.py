"""Runs and their comparison: this package combines scene, physics and recording."""
