"""Initial states of the bodies: explicit ones as written, groups at random without overlaps."""

from carom.scene.placement.initial_state import place
from carom.scene.placement.matter import body_mass, mean_mass
from carom.scene.placement.region import packing_fraction
from carom.scene.placement.start import Start

__all__ = ["Start", "body_mass", "mean_mass", "packing_fraction", "place"]
