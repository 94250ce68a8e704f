"""What to simulate: validated data, and where the bodies start."""
