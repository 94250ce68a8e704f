"""Labels in the viewer's font, Inter, as shipped with Rerun 0.41: its characters, widths, and room for each label."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

from carom.arrays import FloatArray
from carom.recording.layout.canvas import Area, View

# Latin, Greek, Cyrillic, punctuation, currencies, fractions, arrows and some mathematical signs
_DRAWN = re.compile(
    r"[\s\x20-\x7e\xa0-\u0148\u014a-\u01c3\u01c5-\u031e\u038e-\u03a1\u03a3-\u03e1\u03f0-\u049d\u04a0-\u04ff"
    r"\u2010-\u2027\u2030-\u205e\u2070-\u2071\u2074-\u208e\u20a0-\u20bf\u2153\u215a-\u2188\u2190-\u2199"
    r"\u2202\u2205-\u2206\u220f\u2211-\u2212\u221a\u221e\u222b\u2248\u2260\u2264-\u2265\u25a0-\u25a2"
    r"\u2605-\u2606]*"
)

_BORDERS = 12.0  # points by which a label is wider than its text
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
_HEIGHT = 25.0  # points, height of a label with its margin
_BELOW = 32.0  # points from the place of a label to its lower edge
_KEPT_SPACE, _KEPT_WIDTH = "\u00a0", 3.4  # a space that is kept, and its width
_END = "\u00ad"  # an invisible character, since the viewer cuts spaces at the end of a label


def drawable(text: str) -> bool:
    """Return whether the font has all characters of a text."""
    return _DRAWN.fullmatch(text) is not None


def label_width(text: str) -> float:
    """Return the width of a label in points."""
    return _BORDERS + sum(_WIDTHS.get(letter, _MEAN) for letter in text)


def padded(text: str, width: float) -> str:
    """Return a text whose label has this width (points), unless the label is already wider."""
    return text + int((width - label_width(text)) / _KEPT_WIDTH) * _KEPT_SPACE + _END


_Placed = tuple[float, float, float]  # half width of a label, and its place, in half heights of the view


def beyond(tips: FloatArray, ways: FloatArray, texts: Sequence[str], eye: View, area: Area) -> FloatArray:
    """Move labels from the tips of arrows, (k, 3) m, onwards along the arrows, so that labels do not cover arrows."""
    across = ways @ eye.axes().T
    across /= np.linalg.norm(across, axis=1, keepdims=True).clip(np.finfo(float).tiny)
    wide = np.array([0.5 * label_width(text) for text in texts])
    # a label is below its place, so a label that moves up must move farther by its height
    points = np.stack([wide * across[:, 0], np.where(across[:, 1] > 0.0, _BELOW, 0.0) * across[:, 1]], axis=1)
    return np.asarray(tips + points * eye.height() / area.height @ eye.axes())


def apart(places: FloatArray, texts: Sequence[str], eye: View, area: Area) -> FloatArray:
    """Move labels at ``places``, (k, 3) m, into the view, and up or down off earlier labels that they would cover."""
    point = 2.0 / area.height  # half heights of the view
    onto = eye.on_screen(places)
    moved, drawn = onto.copy(), list[_Placed]()
    for k, text in enumerate(texts):
        wide, tall, low = np.array([0.5 * label_width(text), _HEIGHT, _BELOW]) * point
        side = max(0.0, area.aspect - wide)
        x, y = np.clip(onto[k], [-side, low - 1.0], [side, 1.0]).tolist()  # a label is centred below its place
        near = [up for other, across, up in drawn if abs(x - across) < wide + other]
        lines = (y + sign * n * tall for n in range(3 * len(texts)) for sign in (-1.0, 1.0))
        free = (at for at in lines if low - 1.0 <= at <= 1.0 and all(abs(at - up) >= tall for up in near))
        y = next(free, y)
        drawn.append((wide, x, y))
        moved[k] = x, y
    # metres per half height of the view, at each label's depth
    metres = eye.slope * (eye.distance - (places - eye.target) @ eye.to_eye)
    return np.asarray(places + metres[:, None] * ((moved - onto) @ eye.axes()))
