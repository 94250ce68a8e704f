"""The names of units as people write them: alone, in the plural, and with the prefixes that are in use.

A prefix before any unit would make quantities of slips of the key, such as 12 hectohours of "12 hh".
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator

_THOUSANDS = tuple("qryzafpnµμumkMGTPEZY")
_WORDS = (
    "quecto",
    "ronto",
    "yocto",
    "zepto",
    "atto",
    "femto",
    "pico",
    "nano",
    "micro",
    "milli",
    "kilo",
    "mega",
    "giga",
    "tera",
    "peta",
    "exa",
    "zetta",
    "yotta",
)
_FEW = ("n", "µ", "μ", "u", "m")
_MANY = ("k", "M", "G", "T")

# Which prefixes stand before which units. Symbols stand before symbols, and words before words.
_TAKEN: dict[str, Iterable[str]] = {
    **dict.fromkeys(("m", "g", "L"), ("c", "d", "h", *_THOUSANDS)),
    **dict.fromkeys(("s", "J", "N", "W", "Hz", "eV"), _THOUSANDS),
    "Pa": ("h", *_THOUSANDS),
    **dict.fromkeys(("pc", "yr", "ly", "t"), _MANY),
    **dict.fromkeys(("rad", "arcsec", "sec"), _FEW),
    "cal": ("k",),
    **dict.fromkeys(("metre", "meter", "gram", "litre", "liter"), ("centi", "deci", "hecto", *_WORDS)),
    **dict.fromkeys(("second", "joule", "newton", "watt", "hertz", "electron_volt", "radian", "arcsecond"), _WORDS),
    "pascal": ("hecto", *_WORDS),
    **dict.fromkeys(("parsec", "year", "tonne"), ("kilo", "mega", "giga", "tera")),
    "calorie": ("kilo",),
}
_IRREGULAR = ("s", "x", "z", "i", "ch", "y", "foot", "feet")  # endings of words that take no s
_SHORT = ("day", "deg", "erg", "hr", "lb", "min", "rev", "sec", "yr")  # that take one all the same


def written_names(defined: Iterable[str]) -> Iterator[str]:
    """Yield all names of the units that are defined: their own, with prefixes, and in the plural."""
    for name in defined:
        takes_s = name in _SHORT or (len(name) > 3 and name.islower() and not name.endswith(_IRREGULAR))
        for prefixed in (name, *(f"{prefix}{name}" for prefix in _TAKEN.get(name, ()))):
            yield prefixed
            if takes_s:
                yield f"{prefixed}s"
