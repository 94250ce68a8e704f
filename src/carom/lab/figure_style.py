"""The look of carom's figures: colours, fonts, and sheets of panels."""

from __future__ import annotations

from contextlib import AbstractContextManager
from typing import TYPE_CHECKING, Any

from carom.errors import needing

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

INK, FAINT = "#1b2a3a", "#8a94a0"
TEXT_IN_SVG = {"svg.fonttype": "none"}  # keeps letters as text, which can be searched and copied


def styled(size: float, what: str = "a figure", **further: Any) -> AbstractContextManager[None]:
    """Return the drawing context of carom's figures, with a font size in points and further settings.

    Raises ExperimentError if matplotlib is not installed.
    """
    with needing("plot", what, "matplotlib"):
        import matplotlib as mpl  # noqa: PLC0415 - an extra
    colours = {"axes.edgecolor": FAINT, "text.color": INK, "axes.labelcolor": INK}
    settings: Any = {"font.size": size} | colours | further
    context: AbstractContextManager[None] = mpl.rc_context(settings)
    return context


def sheet(count: int, columns: int, panel: tuple[float, float]) -> tuple[Figure, list[Axes]]:
    """Return a figure and its ``count`` panels, in rows of ``columns``; a panel has a width and a height in inches."""
    from matplotlib.figure import Figure  # noqa: PLC0415 - an extra

    rows = -(-count // columns)
    figure = Figure(figsize=(panel[0] * columns, panel[1] * rows + 0.4), layout="constrained", dpi=150)
    places = figure.subplots(rows, columns, squeeze=False).ravel()
    for axes in places[count:]:
        axes.set_visible(False)
    return figure, list(places[:count])
