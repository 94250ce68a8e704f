"""Contact laws beside Coulomb's, each a module that is built on `carom.extend` and can be removed with its row."""
