"""Forks of a recorded run: its continuation under other parameters, or from a state that differs in the last bits."""
