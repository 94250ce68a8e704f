"""An extension of carom: each module is one part of it."""
