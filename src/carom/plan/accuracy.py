"""The accuracy that a tree can reach."""

from __future__ import annotations

from carom.plan.auto import gravity_method
from carom.scene.error import SceneError
from carom.scene.schema import Scene

TREE_ERROR = 6e-4  # position error over the size for an opening angle of 1 rad, with quadrupoles (docs/trade.md)
TREE_ORDER = 4  # of that error in the opening angle: 5 × 10⁻⁶ at 0.3, 1.2 × 10⁻⁴ at 0.7
MONOPOLES = 19.0  # largest factor on it without quadrupoles
SMALLEST_ANGLE = 0.1  # rad; below, a direct sum is as fast


def refuse_coarse_tree(scene: Scene) -> None:
    """Refuse a tree whose error is larger than the requested one.

    Raises
    ------
    SceneError
        With an opening angle that is small enough.
    """
    accuracy, gravity = scene.time.accuracy, scene.gravity
    if accuracy is None or gravity_method(scene) != "tree":
        return
    worst = TREE_ERROR if gravity.quadrupoles else MONOPOLES * TREE_ERROR
    error, angle = worst * gravity.opening_angle**TREE_ORDER, (accuracy / worst) ** (1 / TREE_ORDER)
    if error <= accuracy:
        return
    better = f"gravity.opening_angle = {_floor(angle)}" if angle >= SMALLEST_ANGLE else 'gravity.method = "direct"'
    raise SceneError(
        f"time.accuracy = {accuracy:g} with a tree of gravity.opening_angle = {gravity.opening_angle:g}, whose error "
        f"is about {error:.0e}; set {better}"
    )


def _floor(angle: float) -> float:
    """Round an angle down to two decimals."""
    return int(100 * angle) / 100
