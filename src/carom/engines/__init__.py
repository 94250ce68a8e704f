"""Other engines: their runs recorded and audited, and scenes compared in several engines; see `carom.record`."""
