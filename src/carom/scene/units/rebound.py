"""Units by the names that REBOUND has for them."""

from __future__ import annotations

from collections.abc import Mapping

_NAMES = {  # by REBOUND's, as far as both know them
    **dict.fromkeys(("m", "cm", "km", "pc", "s", "yr", "kyr", "kg", "g"), ""),
    **{"au": "au", "aus": "au", "parsec": "pc", "hr": "h", "d": "day", "day": "day", "days": "day"},
    **dict.fromkeys(("year", "years", "yrs", "jyr"), "yr"),
    **{"myr": "Myr", "gyr": "Gyr", "gram": "g", "mearth": "M_earth", "mjupiter": "M_jupiter"},
    **dict.fromkeys(("msun", "solarmass", "sunmass", "msolar"), "M_sun"),
}
_NAMES.update({name: name for name, known in _NAMES.items() if not known})


def units_of_rebound(units: Mapping[str, str | None]) -> str:
    """Name the units of a simulation, such as "au, day, M_sun"; empty if it has none, or carom does not know one."""
    known = [_NAMES.get(units[what] or "", "") for what in ("length", "time", "mass")]
    return ", ".join(known) if all(known) else ""
