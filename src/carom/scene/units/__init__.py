"""Units: texts such as "3 km" in a scene, the units that a scene selects, and numbers printed with them."""
