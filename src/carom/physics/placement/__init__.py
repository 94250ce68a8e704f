"""Initial states: explicit bodies as written, groups at random without overlaps."""

from carom.physics.placement.initial_state import place
from carom.physics.placement.region import packing_fraction

__all__ = ["packing_fraction", "place"]
