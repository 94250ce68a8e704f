"""Integrators: how the motion between contacts is computed. `carom.scene.integrators` lists them."""
