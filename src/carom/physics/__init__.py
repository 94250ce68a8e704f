"""How it moves: arrays and kernels. No files, no printing."""
