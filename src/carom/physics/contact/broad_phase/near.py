"""The test that makes two spheres a near pair, of all searches."""

from __future__ import annotations

from carom.physics.jit.decorators import inline
from carom.physics.vector import Vector, nearest_image


@inline
def are_near(dx: float, dy: float, dz: float, radii: float, box: Vector, scale: float, skin: float) -> bool:
    """Tell whether two spheres are no farther apart than ``radii scale + skin``.

    Parameters
    ----------
    dx, dy, dz
        m, from one centre to the other.
    radii
        m, the sum of the radii.
    box
        Size of the periodic box in m, zeros in open space: numbers, since an array would be read for each pair.
    scale, skin
        As in `Search`; skin in m.
    """
    if box[0] > 0.0:
        dx, dy, dz = nearest_image(dx, dy, dz, box[0], box[1], box[2])
    reach = radii * scale + skin
    return dx * dx + dy * dy + dz * dz <= reach * reach
