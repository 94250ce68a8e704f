"""What pictures of the viewer show, found by colour."""

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from carom.recording.layout import LEGEND_SHARE

Pixels = NDArray[np.int64]


def region(pixels: Pixels, left: float, top: float, right: float, bottom: float) -> Pixels:
    """Cut out a part of the window, given in fractions of its sides."""
    height, width, _ = pixels.shape
    return pixels[int(top * height) : int(bottom * height), int(left * width) : int(right * width)]


def view(pixels: Pixels, number: int, shares: tuple[float, ...] = (3, 2.2)) -> Pixels:
    """Cut out one of the 3D views, given their widths, left of a legend."""
    edges = np.concatenate([[0.0], np.cumsum(shares)]) / sum(shares) * (1.0 - LEGEND_SHARE)
    return region(pixels, edges[number] + 0.003, 0.065, edges[number + 1] - 0.003, 0.54)


def of_colour(pixels: Pixels, colour: int, tolerance: int = 25) -> int:
    """Count the pixels near a colour of the palette."""
    wanted = np.array([colour >> 24 & 0xFF, colour >> 16 & 0xFF, colour >> 8 & 0xFF])
    return int(np.sum(np.all(np.abs(pixels - wanted) <= tolerance, axis=2)))


def hue_mask(pixels: Pixels, colour: int, apart: float = 0.06) -> NDArray[np.bool_]:
    """Return which pixels have a colour in any shade: light falls on the spheres from one side."""
    wanted = np.array([colour >> 24 & 0xFF, colour >> 16 & 0xFF, colour >> 8 & 0xFF]) / 255
    brightness = pixels.sum(axis=2)
    share = pixels / np.maximum(brightness, 1)[..., None]
    near = np.all(np.abs(share - wanted / wanted.sum()) < apart, axis=2)
    return np.asarray(near & (brightness > 90))


def largest_piece(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the largest connected piece of a mask: a body, not a word of the legend in its colour."""
    pieces, _ = ndimage.label(mask)
    return np.asarray(pieces == 1 + np.argmax(np.bincount(pieces.ravel())[1:]))


def of_hue(pixels: Pixels, colour: int, apart: float = 0.06) -> int:
    """Count the pixels of a colour in any shade."""
    return int(np.sum(hue_mask(pixels, colour, apart)))
