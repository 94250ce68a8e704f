"""Shapes of walls besides planes: one module each."""
