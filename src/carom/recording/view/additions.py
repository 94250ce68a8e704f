"""`Additions`: what a layout shows besides what is in the file, because the viewer is sent it on top."""

from __future__ import annotations

from dataclasses import dataclass

from carom.recording.view.body_plots import BodyPlots
from carom.recording.view.close_up import CloseUp


@dataclass(frozen=True, slots=True)
class Additions:
    """What there is in addition; by default nothing."""

    close: CloseUp | None = None
    trails: bool = False
    recoloured: bool = False
    plots: BodyPlots | None = None  # of single bodies


NONE = Additions()
