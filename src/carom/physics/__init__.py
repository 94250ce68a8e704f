"""The physics: arrays and kernels, without files or printing."""
