"""Broad phase: the search for pairs of spheres, and of spheres and planes, that may touch."""
