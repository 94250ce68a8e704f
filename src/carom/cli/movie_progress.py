"""What a person sees while a movie is made."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Self

import numpy as np
from numpy.typing import NDArray

from carom.cli.live_line import LiveLine, bar
from carom.cli.units import duration_text
from carom.scene.units.dimension import TIME
from carom.scene.units.system import UnitSystem


class MovieProgress(LiveLine):
    """Pictures made, time for each, and time left."""

    def __init__(self, path: Path, times: NDArray[np.float64], units: UnitSystem) -> None:
        super().__init__()
        self._path = path
        self._units = units
        self._times = times  # s, of the frame that each picture shows
        self._made = 0
        self._first: float | None = None  # when the first picture was there: the viewers were starting before
        self._last = 0.0

    def __enter__(self) -> Self:
        self._restart()
        times = self._times
        frames = len(np.unique(times))
        shown = "" if frames == len(times) else f", of {frames} recorded frames"
        span = self._units.span(times[0], times[-1], TIME)
        self.say(f"{self._path}: {len(times)} pictures{shown}, from {span}")
        return super().__enter__()

    def watched(self, pictures: Iterable[bytes]) -> Iterator[bytes]:
        """Pass the pictures on, and show how many there are."""
        for picture in pictures:
            self._made += 1
            self._last = time.perf_counter()
            self._first = self._first or self._last
            self._show(self._line)
            yield picture

    def summary(self) -> str:
        """Say how many pictures were made, and how fast."""
        return f"{self._made} pictures, rendered in {self._pace():.2g} s each"

    def _pace(self) -> float:
        """Return the seconds for a picture, without the start of the viewers."""
        return (self._last - (self._first or self._last)) / max(1, self._made - 1)

    def _line(self, now: float) -> str:
        left = duration_text(self._pace() * (len(self._times) - self._made)) if self._made > 1 else "?"
        done = self._made / len(self._times)
        return f"{bar(done)} {done:4.0%}  picture {self._made} of {len(self._times)}  {left} left"
