"""What to simulate: validated data, and the initial state of the bodies."""
