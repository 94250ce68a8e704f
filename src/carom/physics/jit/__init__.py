"""Compiled kernels, and the threads that share their work."""
