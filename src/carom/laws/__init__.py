"""Contact laws other than Coulomb's. Each is a module built on `carom.extend`, and can be removed with its row."""
