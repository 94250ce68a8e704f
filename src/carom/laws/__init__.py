"""Contact laws other than Coulomb's: modules built on `carom.extend`, each of which can be removed with its row."""
