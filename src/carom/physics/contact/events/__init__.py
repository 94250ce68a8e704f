"""Continuous collision detection: impacts resolved at their exact times within a drift."""
