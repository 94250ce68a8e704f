"""The exception of a run that cannot go on."""

from __future__ import annotations


class PhysicsError(RuntimeError):
    """The state is no longer one that can be stepped: not finite, or a step too small to move the clock."""
