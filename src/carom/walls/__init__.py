"""Shapes of walls besides planes: one module for each shape."""
