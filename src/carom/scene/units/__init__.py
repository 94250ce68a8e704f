"""Units: texts such as "3 km" in a scene, the units that a scene asks for, and numbers written with them."""
