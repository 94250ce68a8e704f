"""Runs: where scene, physics and recording meet."""
