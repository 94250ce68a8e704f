"""`Additions`: the parts of a layout that are not in the file; the viewer gets them in a `Supplement`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from carom.show.body_plots import BodyPlots
    from carom.show.close_up import CloseUp


@dataclass(frozen=True, slots=True)
class Additions:
    """Parts to show in addition; by default none."""

    close: CloseUp | None = None
    trails: bool = False
    recoloured: bool = False
    plots: BodyPlots | None = None  # of single bodies


NONE = Additions()
