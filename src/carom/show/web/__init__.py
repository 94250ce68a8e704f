"""A recording in a browser: Rerun's web viewer, the page around it, and a server on this machine."""
