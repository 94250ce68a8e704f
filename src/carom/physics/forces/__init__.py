"""The forces between contacts: one module for each row of `carom.scene.forces.FORCES`."""
