"""Where two recordings differ, and how fast."""
