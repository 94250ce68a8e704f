"""A scene in several engines: measured, judged, and compared with the reference."""
