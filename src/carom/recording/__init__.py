"""What is kept of a run: writing it, reading it back, looking at it. The one package that imports rerun."""
