"""A run at one moment, as data: frames, checkpoints, energies and totals. This package contains no kernels."""
