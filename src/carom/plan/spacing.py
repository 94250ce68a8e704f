"""How far apart bodies begin."""

from __future__ import annotations

import numpy as np

from carom.scene.schema import Scene

LEAST_DISTANCE = 8.0  # sums of radii; Europa is 9 from Jupiter, the Moon 47 from the Earth
MOST_BODIES = 32  # bodies; more that draw together soon meet often


def far_apart(scene: Scene) -> bool:
    """Tell whether bodies are few and begin far apart, as planets, moons and comets do; not where groups place them."""
    if scene.group or not 2 <= scene.count <= MOST_BODIES:
        return False
    position = np.array([body.position for body in scene.body]).reshape(-1, 3)
    radius = np.array([body.radius for body in scene.body])
    position = np.concatenate([position, *(columns.position for columns in scene.data)])
    radius = np.concatenate([radius, *(columns.radius for columns in scene.data)])
    i, j = np.triu_indices(len(radius), 1)
    distance = np.sqrt(((position[i] - position[j]) ** 2).sum(axis=1))
    return bool(np.all(distance >= LEAST_DISTANCE * (radius[i] + radius[j])))
