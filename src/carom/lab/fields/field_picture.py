"""The picture of fields: means over the depth of the grid, in a panel for each field."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from carom.arrays import FloatArray
from carom.lab.fields.field_arrays import Fields
from carom.lab.figure_style import FAINT, TEXT_IN_SVG, sheet, styled
from carom.scene.units.dimension import ENERGY, LENGTH, PRESSURE, TIME, VELOCITY, Dimension
from carom.scene.wording import in_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes

COLUMNS = 3
PANEL = 3.3  # length of the longer side of a panel, in inches
FLAT = 4  # smallest ratio of cells along x and y to cells along z for which a grid is shown from above
MOST_ARROWS = 14  # largest number of arrows along a side
_PLAIN = Dimension("number", "", (0, 0, 0, 0), "3")


class Panel(NamedTuple):
    """A field as an image."""

    label: str
    values: FloatArray  # (across, up)
    dimension: Dimension
    arrows: tuple[FloatArray, FloatArray] | None = None  # arrows' components along the picture's axes


def draw(fields: Fields, path: Path) -> None:
    """Draw the fields into a PNG or SVG, in the units of the scene.

    The picture is a view from the side, with z upwards; a flat grid, such as a table, is viewed from above. Densities
    and stresses are means over the depth. Velocity and temperature are weighted with mass, coordination with the number
    of bodies. Raises ExperimentError if matplotlib is not installed.
    """
    style = styled(8, "a picture of fields", **TEXT_IN_SVG)
    x, y, z = fields.shape
    depth = 2 if FLAT * z <= min(x, y) else int(x >= y)
    across, up = (axis for axis in range(3) if axis != depth)
    panels = [panel for panel in _panels(fields, depth, across, up) if np.isfinite(panel.values).any()]
    width, height = (fields.shape[axis] * fields.cell[axis] for axis in (across, up))
    longer = max(width, height)
    size = PANEL * max(width / longer, 0.45) + 1.2, PANEL * max(height / longer, 0.3) + 0.9
    with style:
        figure, places = sheet(len(panels), COLUMNS, size)
        for axes, panel in zip(places, panels, strict=True):
            _show(axes, panel, fields, across, up)
        span = fields.units.span(fields.start, fields.end, TIME)
        figure.suptitle(f"{in_figure(fields.title)}, mean of {span} and over {'xyz'[depth]}", fontsize=10)
        figure.savefig(path, format=path.suffix[1:])


def _panels(fields: Fields, depth: int, across: int, up: int) -> list[Panel]:
    """Return the means over the depth of the grid."""

    def mean(values: FloatArray, weight: FloatArray | None = None) -> FloatArray:
        if weight is None:
            return np.asarray(values.mean(axis=depth))
        with np.errstate(invalid="ignore"):
            return np.asarray(np.nansum(values * weight, axis=depth) / weight.sum(axis=depth))

    velocity = [mean(fields.velocity[..., axis], fields.density) for axis in range(3)]
    speed = np.sqrt(np.sum(np.square(velocity), axis=0))
    kinetic, contact = (
        np.trace(each, axis1=3, axis2=4) / 3.0 for each in (fields.kinetic_stress, fields.contact_stress)
    )
    known = np.isfinite(fields.coordination).any()
    coordination = mean(fields.coordination, fields.number_density) if known else np.full(speed.shape, np.nan)
    return [
        Panel("solid fraction", mean(fields.solid_fraction), _PLAIN),
        Panel("velocity", speed, VELOCITY, (velocity[across], velocity[up])),
        Panel("granular temperature", mean(fields.granular_temperature, fields.number_density), ENERGY),
        Panel("pressure of moving bodies", mean(kinetic), PRESSURE),
        Panel("pressure of contacts", mean(contact), PRESSURE),
        Panel("lasting contacts of a body", coordination, _PLAIN),
    ]


def _show(axes: Axes, panel: Panel, fields: Fields, across: int, up: int) -> None:
    units = fields.units
    values = panel.values * units.shown(1.0, panel.dimension)
    x, y = (fields.faces(axis) * units.shown(1.0, LENGTH) for axis in (across, up))
    image = axes.pcolormesh(x, y, values.T, cmap="viridis", vmin=min(0.0, np.nanmin(values)), rasterized=True)
    bar = axes.figure.colorbar(image, ax=axes, shrink=0.8)
    bar.outline.set_visible(False)
    if panel.arrows is not None and np.nanmax(values) > 0.0:
        every = max(1, -(-max(values.shape) // MOST_ARROWS))
        middle = [(faces[1:] + faces[:-1])[::every] / 2.0 for faces in (x, y)]
        along, upwards = (component[::every, ::every].T for component in panel.arrows)
        longest = np.nanmax(values) / (every * (x[1] - x[0]))  # ratio of a velocity to the length of its arrow
        one = units.shown(1.0, panel.dimension)
        how: Any = {"angles": "xy", "scale_units": "xy", "scale": longest, "pivot": "middle", "width": 0.006}
        axes.quiver(*middle, along * one, upwards * one, color="white", **how)
    axes.set(xlabel=units.labelled("xyz"[across], LENGTH), ylabel=units.labelled("xyz"[up], LENGTH), aspect="equal")
    axes.set_title(units.labelled(panel.label, panel.dimension), fontsize=8)
    axes.tick_params(which="both", color=FAINT)
