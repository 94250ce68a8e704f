"""Sleep of bodies at rest: an optional part, which a scene switches on by `contact.sleep`."""
