"""Additions to the view of the bodies: an arrow and axes for a uniform field, and the names of few bodies."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import rerun as rr

from carom.arrays import FloatArray
from carom.recording.layout import FIELD
from carom.recording.layout.camera import View
from carom.recording.layout.canvas import Area
from carom.recording.layout.drawing import line_radii, shape, single
from carom.recording.schema import palette
from carom.recording.schema.header import Header
from carom.scene.units import dimension
from carom.show.supplement import Static

MOST_NAMES = 12
_ROW, _LETTER = 24.0, 7.5  # points, height of a label and width of a letter
_LENGTH = 0.16  # of the field's arrow, in heights of the view; axes are 0.6 times as long
_AXES = np.array([0xD42A1EFF, 0x0FA35AFF, 0x4A66F0FF], dtype=np.uint32)  # x, y, z


def field_arrows(
    header: Header,
    view: View,
    area: Area,
    field: FloatArray,
    drawn: FloatArray,
    radius: FloatArray,
    legend: tuple[int, int] | None = None,
) -> Iterator[Static]:
    """Draw a uniform field as an arrow at the upper border of the view, and the axes of space at the lower border.

    Each is on the left, unless it would cover less on the right; in a corner with a legend, beside it.

    Parameters
    ----------
    field
        (3,) m/s².
    drawn, radius
        (k, 3) and (k,) m, of bodies and points of their paths.
    legend
        The corner of the legend in this view, if it has one.
    """
    height, size = view.height(), float(np.linalg.norm(field))
    right, up = view.axes()
    length = _LENGTH * height
    text = f"gravity, {header.units.text(size, dimension.ACCELERATION, '.4g')}"
    places, sizes = view.on_screen(drawn), view.radius_on_screen(drawn, radius)[:, None]
    reach = np.array([_LETTER * (len(text) + 1) / area.height, _LENGTH])  # half of the label and of the arrow
    origins = []
    for middle, extent, start in ((0.84 - _LENGTH, reach, 0.84), (-0.72, np.full(2, 1.5 * _LENGTH), -0.72)):
        aside = np.zeros(2)  # by how far the legend displaces it on each side
        if legend is not None and legend[1] * start > 0.0:
            aside[int(legend[0] > 0)] = -2.0 * legend[1] * area.inset_share[1]
        sides = [np.array([x * 0.72 * area.aspect, middle + down]) for x, down in zip((-1.0, 1.0), aside, strict=True)]
        covered = [np.all(np.abs(places - side) < extent + sizes, axis=1).sum() for side in sides]
        chosen = int(covered[1] < covered[0]) if covered[0] != covered[1] else int(aside[0] != 0.0)
        x, y = sides[chosen][0], start + aside[chosen]
        origins.append(view.target + 0.5 * height * (x * right + y * up))
    top, corner = origins
    vectors = np.vstack([length * field / size, 0.6 * length * np.eye(3)])
    theme = area.theme
    ink, arrow = palette.INKS[theme], palette.legible([palette.FIELD], theme)
    yield (
        FIELD,
        rr.Arrows3D(
            origins=single(np.stack([top, corner, corner, corner])),
            vectors=single(vectors),
            colors=np.concatenate([arrow, palette.legible(_AXES, theme)]),
            radii=line_radii(0.05 * length, 1.0),
        ),
    )
    texts = [text, "x", "y", "z"]
    ends = np.vstack([top + 0.5 * vectors[0], corner + 1.15 * vectors[1:]])
    yield (
        f"{FIELD}/labels",
        rr.Points3D(single(ends), radii=1e-6 * length, labels=texts, colors=ink, show_labels=True),
    )


def names_that_fit(header: Header, position: FloatArray, view: View, area: Area) -> tuple[str, ...]:
    """Return the names of bodies, few enough and far enough apart in a view not to overlap.

    A name that would overlap that of a larger body is empty.

    Parameters
    ----------
    position
        (n, 3) m.
    view
        It has this `area`.

    Returns
    -------
    names
        (n,), or () if no name is shown.
    """
    n = len(position)
    if not any(header.names) or n > MOST_NAMES or n != len(header.names) or shape(header) != "ellipsoids":
        return ()
    points = (position - view.target) @ view.axes().T * area.height / view.height()
    wide = np.array([_LETTER * (len(name) + 1) for name in header.names])
    across, up = np.abs(points[:, None] - points[None]).transpose(2, 0, 1)
    overlap = (across < (wide[:, None] + wide) / 2.0) & (up < _ROW)
    shown = np.zeros(n, dtype=bool)
    for k in np.argsort(-header.radius, kind="stable"):
        shown[k] = np.isfinite(points[k]).all() and not (overlap[k] & shown).any()
    return tuple(name if each else "" for name, each in zip(header.names, shown.tolist(), strict=True))
