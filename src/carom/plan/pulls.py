"""What accelerates bodies between contacts."""

from __future__ import annotations

from carom.scene.parts import Part
from carom.scene.schema import Scene


def gravity(scene: Scene) -> Part:
    """Decide whether bodies pull each other."""
    name, n = "gravity", scene.count
    if scene.gravity.method == "none":
        return Part(name, False, 'gravity.method = "none"')
    if scene.gravity.constant == 0:
        return Part(name, False, "gravity.constant = 0")
    if n == 1:
        return Part(name, False, "one body pulls nothing else")
    return Part(name, True, f"{n} bodies, G = {scene.gravity.constant:g} m³ kg⁻¹ s⁻²")


def field(scene: Scene) -> Part:
    """Decide whether a uniform field pulls."""
    if any(scene.gravity.uniform):
        return Part("uniform-field", True, f"gravity.uniform = {list(scene.gravity.uniform)} m/s²")
    return Part("uniform-field", False, "gravity.uniform is zero")
