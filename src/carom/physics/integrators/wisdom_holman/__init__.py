"""Wisdom–Holman integration; a folder that can be deleted with its row in `carom.registry`."""
