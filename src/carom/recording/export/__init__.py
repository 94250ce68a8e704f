"""Bodies of a recording in the formats of other tools. Each format is a module."""
