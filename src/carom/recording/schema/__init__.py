"""What a recording holds: entities, timelines, properties, series and their versions."""
