"""Bodies that enter and leave during a run; those that wait are outside of the physics."""
