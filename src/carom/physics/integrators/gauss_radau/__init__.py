"""Gauss–Radau integration; a folder that can be removed with its row in `carom.registry`."""
