"""A run at one moment, as data: frames, checkpoints, energies and totals. It contains no kernels."""
