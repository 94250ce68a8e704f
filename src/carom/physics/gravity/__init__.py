"""How bodies pull each other."""
