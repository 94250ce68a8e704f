"""How a recording looks: blueprint, camera, arrows, pictures and the viewer itself."""
