"""Colours of bodies by speed, by their colour in the collision graph, or by island."""

from __future__ import annotations

import numpy as np

from carom.arrays import ColourArray, FloatArray, IntArray
from carom.physics.contact.graph import colour_bodies
from carom.recording.schema import palette

# Matplotlib's plasma from 0.15 to 1, perceptually uniform; its dark end would be invisible on the dark background.
SPEEDS = np.array(
    [0x5001A2FF, 0x7501A8FF, 0x9A169FFF, 0xB83289FF, 0xD14E72FF, 0xE56B5DFF, 0xF58C46FF, 0xFDB130FF, 0xF9DB24FF],
    dtype=np.uint32,
)


def speed_colours(speed: FloatArray, reference: float) -> ColourArray:
    """Return colours of speeds (m/s) from violet to yellow; the reference is in the middle."""
    share = speed / (speed + reference) if reference > 0.0 else np.zeros(len(speed))
    return SPEEDS[np.minimum((len(SPEEDS) * np.nan_to_num(share)).astype(np.int64), len(SPEEDS) - 1)]


def speeds(velocity: FloatArray, mass: FloatArray) -> FloatArray:
    """Return the speeds (n,) m/s in the frame of the centre of mass; NaN for bodies that do not exist."""
    if np.isnan(velocity[:, 0]).any():
        there = np.isfinite(velocity).all(axis=1)
        found = np.full(len(velocity), np.nan)
        found[there] = speeds(velocity[there], mass[there]) if there.any() else np.nan
        return found
    return np.asarray(np.linalg.norm(velocity - np.average(velocity, axis=0, weights=mass), axis=1))


def graph_colours(pairs: IntArray, bodies: int) -> ColourArray:
    """Return the colours of the reference engine: touching bodies differ, and bodies without contacts are grey."""
    return palette.node_colours(colour_bodies(np.ascontiguousarray(pairs, dtype=np.int64), bodies)[1])


def island_colours(pairs: IntArray, bodies: int) -> ColourArray:
    """Return a colour for each island of bodies connected by contacts; bodies without contacts are grey."""
    from scipy.sparse import coo_array  # noqa: PLC0415 - 0.1 s to import, and seldom needed
    from scipy.sparse.csgraph import connected_components  # noqa: PLC0415

    joined = pairs[pairs[:, 1] < bodies]
    graph = coo_array((np.ones(len(joined), dtype=np.int8), (joined[:, 0], joined[:, 1])), shape=(bodies, bodies))
    _, island = connected_components(graph, directed=False)
    first = np.full(bodies, bodies, dtype=np.int64)
    np.minimum.at(first, island, np.arange(bodies))
    alone = np.bincount(island, minlength=bodies)[island] == 1
    cycle = np.array(palette.BODIES, dtype=np.uint32)
    return np.where(alone, np.uint32(palette.GREY), cycle[first[island] % len(cycle)])
