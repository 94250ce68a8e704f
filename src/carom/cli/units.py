"""Numbers as a person reads them."""

from __future__ import annotations

from carom.scene.units.dimension import TIME
from carom.scene.units.system import UnitSystem

MINUTE, HOUR, DAY, YEAR = 60.0, 3600.0, 86400.0, 365.25 * 86400.0


def duration_text(seconds: float) -> str:
    """Write a duration with a unit that fits it."""
    for unit, name in ((YEAR, "years"), (DAY, "d"), (HOUR, "h"), (MINUTE, "min")):
        if seconds >= 2 * unit:
            return f"{seconds / unit:.3g} {name}"
    return f"{seconds:.3g} s"


def simulated_text(seconds: float, units: UnitSystem) -> str:
    """Write a length of simulated time: in the unit of the scene or, in SI, with one that fits it."""
    return duration_text(seconds) if units.is_si else units.text(seconds, TIME, ".4g")


def count_text(count: int) -> str:
    """Write an estimated number in three digits."""
    about = float(f"{count:.3g}")
    if about >= 1e9:
        return f"{about:.3g}"
    return f"{about / 1e6:.3g} million" if about >= 1e6 else f"{about:.0f}"


def bytes_text(count: float) -> str:
    """Write a number of bytes in decimal units."""
    for unit, name in ((1e9, "GB"), (1e6, "MB"), (1e3, "kB")):
        if count >= unit:
            return f"{count / unit:.3g} {name}"
    return f"{count:.0f} B"
