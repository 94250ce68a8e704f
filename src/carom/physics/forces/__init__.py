"""The forces other than contacts: one module for each row of `carom.scene.forces.FORCES`."""
