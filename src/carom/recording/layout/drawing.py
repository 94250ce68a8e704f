"""How bodies, lines, arrows and impulses are drawn, for scenes of any size.

**Arrows** stand for vectors whose SI magnitudes are arbitrary and span decades. An arrow starts at its body's centre
and extends beyond the sphere by

    L(m) = L_max · s / (1 + s),   s = (m / m_ref)^(1/3)

so its vector is ``(r + L) m̂`` (`encoding.draw_arrows`). L grows with m, is less than L_max and can be inverted:
m = m_ref · (u / (1 - u))³ with u = L / L_max. Thanks to the cube root, six decades fit between 9 % and 91 % of L_max.
Therefore m_ref can come from the first frame with arrows and apply to the whole recording: arrows are visible even if
m_ref is wrong by a factor of 1000.

A sphere's torque and angular acceleration are parallel (τ = I α), as are the angular impulse of an impact and the
change of spin (L = I Δω). Views draw torques and angular impulses, short and thick; both magnitudes are written beside
the arrows of few bodies. The other arrows, long and thin, are hidden until somebody asks for them.

**Impulses** of contacts and impacts have eight widths and colours. A magnitude is drawn by u = s / (1 + s), like the
length of an arrow, and the eight levels of u have equal widths. Levels save 6 of 8 bytes per contact in the file,
because neighbours often have the same level.

**Lines**: Rerun 0.41 stores the radii of lines in half precision: radii above 65 504 units are not drawn,
and radii below 10⁻⁶ are rounded by more than 3 %. In such scenes, lines get radii in points of the screen, which Rerun
expresses as negative numbers.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from carom.arrays import ColourArray, FloatArray, IntArray, SingleArray
from carom.recording.schema import palette
from carom.recording.schema.header import Header
from carom.recording.schema.paths import (
    ANGULAR_ACCELERATION,
    ANGULAR_IMPULSE,
    FORCE_FRICTION,
    FORCE_NORMAL,
    SPIN_CHANGE,
    TORQUE,
)
from carom.scene.units import dimension

# Matplotlib's viridis from 0.16 to 0.86, perceptually uniform: without its dark end, which would be invisible on the
# dark background, and without its yellow, the colour of impulses.
SPEEDS = np.array(
    [0x453781FF, 0x3B518BFF, 0x31688EFF, 0x277E8EFF, 0x20928CFF, 0x22A785FF, 0x3DBC74FF, 0x69CD5BFF, 0xA2DA37FF],
    dtype=np.uint32,
)

MOST_ELLIPSOIDS = 2000  # largest number of wireframe bodies; each costs the viewer 16 to 25 times as much as a point


def shape(header: Header) -> str:
    """Return the shape of drawn bodies: "ellipsoids" or, for many bodies, "mesh" (with orientations) or "points"."""
    if header.drawn_as:
        return header.drawn_as
    if header.bodies <= MOST_ELLIPSOIDS:
        return "ellipsoids"
    return "mesh" if header.has_orientation else "points"


def single(values: FloatArray) -> SingleArray:
    """Round to float32; larger values become infinite, as in the kernels that cast positions."""
    with np.errstate(over="ignore"):
        return values.astype(np.float32)


_LEAST, _LARGEST = 1e-6, 6e4  # m, range of radii that Rerun draws accurately enough
_POINTS = 40.0  # points of the screen that stand for the radius of a body


def line_radii(share: ArrayLike, body: float) -> SingleArray:
    """Return radii of lines for the viewer, given as fractions (...) of a body's radius (m)."""
    shares = np.asarray(share, dtype=np.float64)
    radii = shares * body
    drawn = radii.min() >= _LEAST and radii.max() <= _LARGEST
    return (radii if drawn else -_POINTS * shares).astype(np.float32)


_ROUND_OFF = 1e-6  # fraction of the natural unit: smaller vectors are rounding noise, and define no scale


def part_of_longest(magnitude: Any, unit: Any) -> Any:
    """Return L / L_max for magnitudes and their unit m_ref (numbers or arrays); 1 for an infinite magnitude."""
    s = np.cbrt(magnitude / unit)
    return 1.0 - 1.0 / (1.0 + s)


def magnitudes(vectors: FloatArray) -> FloatArray:
    """Return the lengths of ``(k, 3)`` vectors; the largest component is the unit, so that no square overflows."""
    largest = np.abs(vectors).max(initial=0.0, where=np.isfinite(vectors))
    if largest == 0.0:
        return np.zeros(len(vectors))
    unit = vectors / largest
    return np.asarray(largest * np.sqrt(np.einsum("ki,ki->k", unit, unit)))


def reference(magnitude: FloatArray, natural_unit: float) -> float:
    """Choose m_ref from the first magnitudes: their median, unless they are rounding noise."""
    return max(float(np.median(magnitude)), _ROUND_OFF * natural_unit, np.finfo(np.float64).tiny)


class References(dict[str, float]):
    """Magnitudes m_ref by name. The first frame with arrows determines the magnitudes that are not given."""

    def __init__(self, given: Mapping[str, float]) -> None:
        super().__init__(given)
        self.chosen: dict[str, float] = {}  # magnitudes that the frames would choose, even if a magnitude was given

    def choose(self, name: str, magnitude: float) -> None:
        """Set a magnitude, unless it was given."""
        self.chosen[name] = magnitude
        self.setdefault(name, magnitude)


DIMENSIONS = {  # dimensions of magnitudes
    FORCE_NORMAL: dimension.IMPULSE,
    TORQUE: dimension.TORQUE,
    ANGULAR_ACCELERATION: dimension.ANGULAR_ACCELERATION,
    ANGULAR_IMPULSE: dimension.ANGULAR_IMPULSE,
    SPIN_CHANGE: dimension.ANGULAR_VELOCITY,
}

# L_max in median body radii
REACH = {
    TORQUE: 2.0,
    ANGULAR_ACCELERATION: 4.0,
    ANGULAR_IMPULSE: 2.0,
    SPIN_CHANGE: 4.0,
    FORCE_NORMAL: 2.0,
    FORCE_FRICTION: 2.0,
}


def arrow_length(header: Header, path: str) -> float:
    """Return L_max (m) of the arrows at an entity."""
    return REACH[path] * float(np.median(header.radius))


def magnitude_at(radii: float, reach: float, reference: float) -> float:
    """Return the magnitude whose arrow extends by ``radii`` median radii, if L_max is ``reach`` median radii.

    With levels in place of radii, the result is the smallest magnitude of a level.
    """
    share = radii / reach
    return reference * (share / (1.0 - share)) ** 3


# Shades of one hue, since each other hue has its own meaning: CIELAB from L = 30 to 78, about vermilion, the colour of
# contacts. A search maximised the differences from colours of bodies (ΔE ≥ 31, CIE76) and of arrows (≥ 33).
COLOURS = np.array(
    [0x872105FF, 0x9F2F09FF, 0xB73E10FF, 0xCD501BFF, 0xE1652BFF, 0xF17B40FF, 0xFF9259FF, 0xFFA974FF], dtype=np.uint32
)
LEVELS = len(COLOURS)
_THINNEST, _THICKEST = 0.03, 0.15  # radii of edges, in median body radii: wider edges would hide arrows
_SMALLEST, _LARGEST_IMPULSE = 0.12, 0.60  # radii of the points at impacts, in median body radii


def edge_radii(radius: FloatArray) -> SingleArray:
    """Return the radius of an edge at each level, (8,), as `line_radii` does."""
    return line_radii(np.linspace(_THINNEST, _THICKEST, LEVELS), float(np.median(radius)))


def point_radii(radius: FloatArray) -> SingleArray:
    """Return the radius of an impact's point at each level, (8,) m."""
    return single(np.median(radius) * np.linspace(_SMALLEST, _LARGEST_IMPULSE, LEVELS))


def level(magnitude: FloatArray, reference: float) -> IntArray:
    """Return the level of each magnitude, 0 to 7; 0 for magnitudes up to zero."""
    u = part_of_longest(np.maximum(magnitude, 0.0), reference)
    levels: IntArray = np.minimum((LEVELS * u).astype(np.int64), LEVELS - 1)
    return levels


def speed_colours(speed: FloatArray, reference: float) -> ColourArray:
    """Return colours of speeds (m/s) from violet to green; the reference speed has the middle colour."""
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
