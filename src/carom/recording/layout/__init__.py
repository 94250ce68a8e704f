"""The layout that a recording opens with: blueprint, cameras, views and plots."""
