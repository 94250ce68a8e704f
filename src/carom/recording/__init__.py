"""Recordings: their schema, bytes, writing, reading, layout and editing."""
