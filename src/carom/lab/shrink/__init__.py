"""Reduces a scene that fails to the smallest one that still fails in the same way."""
