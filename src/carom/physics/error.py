"""The exception for a run that cannot continue."""

from __future__ import annotations


class PhysicsError(RuntimeError):
    """The run cannot continue: the state is not finite, or the step is too small to change the clock."""
