"""Runs a scene and records it; replays and resumes recorded runs."""
