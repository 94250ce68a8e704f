"""Recordings: writing, reading, editing and viewing them. The only package that imports Rerun."""
