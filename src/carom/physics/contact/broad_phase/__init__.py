"""Broad phase: which pairs of spheres, and which spheres and planes, are near enough to touch."""
