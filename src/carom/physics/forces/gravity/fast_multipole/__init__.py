"""Gravity by fast multipoles; a folder that can be deleted with its row in `carom.registry`."""
