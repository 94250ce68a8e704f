"""Forks of a recorded run: what if, from a moment on, under other parameters or from a state that differs by a bit."""
