"""Search for scenes that break the laws of physics or carom's own promises."""
