"""The schema of a recording: entities, timelines, properties, series, and their version."""
