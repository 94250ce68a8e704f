"""Sleep of bodies at rest: an optional part, switched on by `contact.sleep`."""
