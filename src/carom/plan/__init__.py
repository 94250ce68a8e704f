"""What a scene requires, what "auto" chooses, and what is refused: decided from the scene alone."""
