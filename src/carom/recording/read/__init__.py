"""Recordings read back: tables, positions, summary."""
