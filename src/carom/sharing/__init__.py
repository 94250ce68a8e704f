"""Recordings for other people: reports of bugs, and pages for a web host."""
