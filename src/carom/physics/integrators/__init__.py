"""Integrators: the methods for the motion between contacts. `carom.scene.integrators` lists them."""
