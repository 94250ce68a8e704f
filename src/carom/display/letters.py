"""The font of the viewer, Inter, as shipped with Rerun 0.41: the characters that it has, and how wide texts are."""

from __future__ import annotations

import re

# Latin, Greek, Cyrillic, punctuation, currencies, fractions, arrows and some signs of mathematics
_DRAWN = re.compile(
    r"[\s\x20-\x7e\xa0-\u0148\u014a-\u01c3\u01c5-\u031e\u038e-\u03a1\u03a3-\u03e1\u03f0-\u049d\u04a0-\u04ff"
    r"\u2010-\u2027\u2030-\u205e\u2070-\u2071\u2074-\u208e\u20a0-\u20bf\u2153\u215a-\u2188\u2190-\u2199"
    r"\u2202\u2205-\u2206\u220f\u2211-\u2212\u221a\u221e\u222b\u2248\u2260\u2264-\u2265\u25a0-\u25a2"
    r"\u2605-\u2606]*"
)

_BORDERS = 12.0  # points, by which a label is wider than its text
_LETTERS = {
    3.1: "ijlI.,:;'·",
    3.4: " \u00a0",
    4.5: "frt()/|",
    5.6: "1-_²³°τ",
    6.9: "acksvxyzJL",
    8.2: "ABKPRSTVXYZ34=+<>×α",
}
_LETTERS |= {9.3: "CDGHNOQUωw%", 11.6: "mMW—→■½"}
_WIDTHS = {letter: width for width, letters in _LETTERS.items() for letter in letters}  # points, measured in a picture
_MEAN = 7.5  # points, width of other letters
_KEPT_SPACE, _KEPT_WIDTH = "\u00a0", 3.4  # a space that is kept, and its width
_END = "\u00ad"  # nothing to be seen; the viewer cuts spaces at the end of a label


def drawable(text: str) -> bool:
    """Return whether the font has all characters of a text."""
    return _DRAWN.fullmatch(text) is not None


def label_width(text: str) -> float:
    """Return the width of a label in points."""
    return _BORDERS + sum(_WIDTHS.get(letter, _MEAN) for letter in text)


def padded(text: str, width: float) -> str:
    """Return a text whose label has this width (points), if it is not wider already."""
    return text + int((width - label_width(text)) / _KEPT_WIDTH) * _KEPT_SPACE + _END
