"""The accuracy that a tree can reach."""

from __future__ import annotations

from typing import NamedTuple

from carom.errors import SceneError
from carom.plan.auto import gravity_method
from carom.scene.schema import Scene


class _Law(NamedTuple):
    """The position error over the size, as a power of the opening angle."""

    error: float  # at 1 rad
    order: int


TREE_ERRORS = {  # of a cluster of 6000 points (docs/trade.md)
    "tree": _Law(6e-4, 4),  # with quadrupoles: 5 × 10⁻⁶ at 0.3, 1.2 × 10⁻⁴ at 0.7
    "fast-multipole": _Law(5e-4, 7),  # an upper bound: 1.8 × 10⁻⁸ at 0.3, 1.2 × 10⁻⁶ at 0.5, 1.7 × 10⁻⁵ at 0.7
}
MONOPOLES = 19.0  # largest factor on it without quadrupoles
SMALLEST_ANGLE = 0.1  # rad; below, a direct sum is as fast


def refuse_coarse_tree(scene: Scene) -> None:
    """Refuse a tree whose error is larger than the requested one.

    Raises
    ------
    SceneError
        With an opening angle that is small enough.
    """
    accuracy, gravity, method = scene.time.accuracy, scene.gravity, gravity_method(scene)
    if accuracy is None or method not in TREE_ERRORS:
        return
    law = TREE_ERRORS[method]
    worst = law.error if gravity.quadrupoles or method != "tree" else MONOPOLES * law.error
    error, angle = worst * gravity.opening_angle**law.order, (accuracy / worst) ** (1 / law.order)
    if error <= accuracy:
        return
    tree = f'gravity.method = "{method}" and opening_angle = {gravity.opening_angle:g}'
    better = f"gravity.opening_angle = {_floor(angle)}" if angle >= SMALLEST_ANGLE else 'gravity.method = "direct"'
    raise SceneError(
        f"time.accuracy = {accuracy:g} with {tree}, whose error is about {error:.0e}; set {better}",
        ("time", "accuracy"),
    )


def _floor(angle: float) -> float:
    """Round an angle down to two decimals."""
    return int(100 * angle) / 100
