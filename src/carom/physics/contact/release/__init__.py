"""Bodies that enter and leave during a run; waiting bodies take no part in the physics."""
