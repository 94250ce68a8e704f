"""The order of pairs: by the first end, then by the second."""

from __future__ import annotations

from carom.physics.jit.decorators import inline


@inline
def comes_before(i: float, j: float, other_i: float, other_j: float) -> bool:
    """Tell whether the pair (i, j) comes before another; the numbers may be stored as floats."""
    return i < other_i or (i == other_i and j < other_j)
