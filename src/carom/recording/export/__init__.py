"""Bodies of a recording in the formats of other tools. Each format has its file."""
