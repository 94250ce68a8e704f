"""Decisions from the scene alone: its required parts, the values of "auto", and refusals."""
