"""Continuous collision detection: impacts resolved at their own times within a drift."""
