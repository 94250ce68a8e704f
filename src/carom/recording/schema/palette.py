"""Colours, as 0xRRGGBBAA, that colour-blind readers can distinguish.

The 3D views use Okabe and Ito's palette on a dark background; on paper, in the light theme, the bright colours of this
palette are darkened (`legible`). Plots have the background of the theme. The curves of plots use `LINES`, whose colours
have a contrast of at least 3 to 1 on both backgrounds.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from carom.arrays import IntArray
from carom.recording.schema import paths

ORANGE = 0xE69F00FF
SKY = 0x56B4E9FF
GREEN = 0x009E73FF
YELLOW = 0xF0E442FF
BLUE = 0x0072B2FF
VERMILION = 0xD55E00FF
PURPLE = 0xCC79A7FF
GREY = 0x9A9A9AFF
WHITE = 0xFFFFFFFF
BACKGROUND = 0x0B0E14FF
GROUNDS = {"dark": BACKGROUND, "light": WHITE}  # grounds of 3D views
INKS = {"dark": WHITE, "light": 0x16181DFF}  # colours of text and lines on these grounds

# A search maximised the smallest difference between two colours, with and without colour blindness: ΔE ≥ 18 (CIE76).
LINES = {
    "blue": 0x4A66F0FF,
    "red": 0xD42A1EFF,
    "green": 0x0FA35AFF,
    "purple": 0xB84DB8FF,
    "grey": 0x6C6C6CFF,
    "orange": 0xF0690FFF,
}
PLOT_GROUNDS = {"light": 0xFFFFFFFF, "dark": 0x0D0D0DFF}  # grounds of plots in the viewer's two themes

# Neighbouring stages must be distinct at a glance, so the order alternates warm and cold colours.
STAGES = (VERMILION, SKY, YELLOW, GREEN, PURPLE, ORANGE, BLUE)
STAGE_NAMES = ("vermilion", "sky blue", "yellow", "green", "purple", "orange", "blue")
SERIAL_STAGE = 64  # contacts with more colours than this are solved serially, last, and drawn white
STAGE_COLOURS = np.array([*itertools.islice(itertools.cycle(STAGES), SERIAL_STAGE), WHITE], dtype=np.uint32)

# Hues of bodies; no quantity has these hues, so a body is never taken for a torque, an impulse or an edge. A search
# over a grid of CIELAB maximised the smallest difference between two of them (ΔE ≥ 39, CIE76; ≥ 22 with colour
# blindness) among colours that differ from `ARROWS` and from edges by at least 33 (11 with colour blindness), and have
# a contrast of 4.2 to 1 on a dark background.
CLAY = 0xA96D59FF
INDIGO = 0x756CE5FF
SAGE = 0xA1C4A8FF
ROSE = 0xF6D2F0FF
OLIVE = 0x9FA041FF
MINT = 0x63F897FF
# hues of bodies; olive comes last, since it resembles the yellow of impulses on white
BODIES = (SKY, CLAY, INDIGO, MINT, SAGE, ROSE, OLIVE)

NAMED = {  # names for colours of materials in scenes; colours of bodies come first
    "sky-blue": SKY,
    "clay": CLAY,
    "indigo": INDIGO,
    "mint": MINT,
    "olive": OLIVE,
    "sage": SAGE,
    "rose": ROSE,
    "orange": ORANGE,
    "green": GREEN,
    "yellow": YELLOW,
    "blue": BLUE,
    "vermilion": VERMILION,
    "purple": PURPLE,
    "grey": GREY,
    "white": WHITE,
}

# The colours that differ most from the colours of bodies, other arrows and edges (ΔE ≥ 53, and ≥ 24 from edges).
MAGENTA = 0xF018F0FF
CRIMSON = 0xF01848FF

ARROWS = {  # colours by entity: an arrow has one colour in every view
    paths.TORQUE: ORANGE,
    paths.ANGULAR_ACCELERATION: GREEN,
    paths.ANGULAR_IMPULSE: MAGENTA,
    paths.SPIN_CHANGE: CRIMSON,
    paths.FORCE_NORMAL: YELLOW,
    paths.FORCE_FRICTION: PURPLE,
}
SPIN = 0x5CE0B0FF  # the green of the palette would hardly be visible on the bodies
FIELD = GREY
GRIDS = {"dark": 0x5A626EFF, "light": 0xA8AEB6FF}  # colours of the grids on planes, fainter than bodies on the planes

SLATE, DEEP_SLATE = 0x6F8296FF, 0x55657AFF  # colours of things that need no hue, since their names are written on them
# Colours of curves for quantities that arrows, edges or points also show: the same hues, with a contrast of 3 to 1 in
# plots.
CONTACTS = VERMILION
IMPACTS = 0x9F9728FF  # colour of impacts: yellow, darkened
FRICTION = PURPLE

PHASES = {"warm-up": GREY, "free": SLATE, "colliding": VERMILION, "settled": DEEP_SLATE}
DT_LIMITS = {  # colours of limits, which are dull unless the limit is about impacts, friction or contacts
    "start": GREY,
    "acceleration": 0x7D6A8CFF,
    "held": 0x8C6BB1FF,
    "velocity": 0x8C7A5CFF,
    "pull": 0x99605AFF,
    "error": 0x99605AFF,
    "impact": YELLOW,
    "friction": PURPLE,
    "horizon": 0x5F8A72FF,
    "cap": SLATE,
    "growth": 0x8C8A5CFF,
    "fixed": SLATE,
    "engine": SLATE,
    "end": DEEP_SLATE,
}

MOST_SINGLE = 70  # largest number of single bodies that get hues in turn; with more, over ten would share a hue

_GOLDEN = 0.6180339887498949  # fractional parts of its first k multiples fill (0, 1) evenly for every k
_SHADE = 0.3  # fraction by which the darkest body of a group is darker than the group's hue
FADED = {"dark": 0x3C4250FF, "light": 0xC4C8D0FF}  # wires of bodies that are not the subject of a view
FAINTEST = {"dark": 0x232833FF, "light": 0xE2E4E9FF}  # such wires in crowds
# luminances with a contrast of 4.5 to 1 on labels, whose grounds are #efefef and #1b1d20 in pictures
_BRIGHTEST_TEXT, _DARKEST_TEXT = 0.15, 0.24
_BRIGHTEST, _DARKEST = 0.3, 0.12  # luminances with a contrast of 3 to 1 on white, and on a dark plot


def legible(colours: Iterable[int], theme: str = "") -> NDArray[np.uint32]:
    """Return colours of the same hues that have a contrast of at least 3 to 1 on a background.

    The theme "dark" leaves the colours unchanged, since the palette is for a dark background; "light" darkens bright
    colours for white paper. By default, the colours suit both themes. Colours of curves must be visible on both
    backgrounds, since plots have the background of the viewer's theme.
    """
    given = np.array([*colours], dtype=np.uint32)
    return given if theme == "dark" else _within(given, 0.0 if theme else _DARKEST, _BRIGHTEST)


def _within(colours: ArrayLike, darkest: float, brightest: float) -> NDArray[np.uint32]:
    """Return colours of the same hues whose luminance is at least ``darkest`` and at most ``brightest``."""
    channels = _channels(colours)
    shares = channels[:, :3] / 255.0
    linear = np.where(shares <= 0.04045, shares / 12.92, ((shares + 0.055) / 1.055) ** 2.4)  # sRGB
    luminance = (linear @ np.array([0.2126, 0.7152, 0.0722]))[:, None]
    linear = linear * np.minimum(1.0, brightest / np.maximum(luminance, brightest))
    if darkest > 0.0:
        linear += (1.0 - linear) * np.maximum(0.0, (darkest - luminance) / (1.0 - luminance).clip(darkest))
    shares = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1.0 / 2.4) - 0.055)
    channels[:, :3] = np.round(255.0 * shares)
    return _colours(channels)


def readable(colours: Sequence[int], theme: str) -> NDArray[np.uint32]:
    """Return colours of text with a contrast of at least 4.5 to 1 on the labels of a theme, as WCAG 2 asks."""
    return _within(colours, 0.0, _BRIGHTEST_TEXT) if theme == "light" else _within(colours, _DARKEST_TEXT, 1.0)


def _channels(colours: ArrayLike) -> NDArray[np.uint8]:
    """Return red, green, blue and opacity of colours, (n, 4)."""
    return np.array(colours, dtype=">u4").view(np.uint8).reshape(-1, 4)


def _colours(channels: NDArray[np.uint8]) -> NDArray[np.uint32]:
    return channels.view(">u4").ravel().astype(np.uint32)


def node_colours(body_colours: IntArray) -> NDArray[np.uint32]:
    """Colours of bodies by their colour in the collision graph; bodies without contacts are grey."""
    cycle = np.array(BODIES, dtype=np.uint32)
    return np.where(body_colours < 0, np.uint32(GREY), cycle[body_colours % len(cycle)])


def body_colours(group: IntArray) -> NDArray[np.uint32]:
    """Return static colours of bodies: a hue for each group and for up to `MOST_SINGLE` single bodies, and shades."""
    count, index, single = len(group), group, np.flatnonzero(group == -1)
    few = count <= len(BODIES)
    if few:
        index = np.arange(count)
    elif len(single) <= MOST_SINGLE:
        index = group.copy()
        index[single] = group.max() + 1 + np.arange(len(single))
    channels = _channels(np.array(BODIES)[index % len(BODIES)])
    darker = np.zeros(count) if few else _SHADE * ((np.arange(count) * _GOLDEN) % 1.0)
    channels[:, :3] = channels[:, :3] * (1.0 - darker)[:, None]
    return _colours(channels)


def material_colours(given: Sequence[str | None]) -> list[int]:
    """Return the colours of materials: from the scene, by name or as "#rrggbb", or otherwise an unused colour."""
    chosen = [None if colour is None else NAMED.get(colour) or int(f"{colour[1:]}ff", 16) for colour in given]
    left = itertools.cycle([hue for hue in BODIES if hue not in chosen] or BODIES)
    return [next(left) if colour is None else colour for colour in chosen]


def name_of(colour: int) -> str:
    """Name a colour, or write it as #rrggbb."""
    names = {value: name.replace("-", " ") for name, value in NAMED.items()}
    return names.get(colour, f"#{colour >> 8:06x}")
