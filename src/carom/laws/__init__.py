"""Contact laws other than Coulomb's, built on `carom.extend`; each can be removed with its row in `carom.registry`."""
