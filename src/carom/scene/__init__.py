"""Scenes: validated data, and the initial state of the bodies."""
