from itertools import combinations

import numpy as np
import pytest
from numpy.typing import NDArray

from carom.recording.layout import drawing
from carom.recording.schema import palette

# How severe dichromats see linear RGB: Machado, Oliveira & Fernandes 2009, table 1, severity 1.0.
VISION = {
    "normal": np.eye(3),
    "protanopia": np.array(
        [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]]
    ),
    "deuteranopia": np.array(
        [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]]
    ),
    "tritanopia": np.array(
        [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.303900]]
    ),
}
TO_XYZ = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])
FloatArray = NDArray[np.float64]


def linear(colour: int) -> FloatArray:
    """Linear RGB of 0xRRGGBBAA."""
    srgb = np.array([colour >> shift & 0xFF for shift in (24, 16, 8)]) / 255
    return np.asarray(np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4))


def contrast(a: int, b: int) -> float:
    """The contrast ratio of WCAG 2."""
    dark, light = sorted(float(TO_XYZ[1] @ linear(colour)) for colour in (a, b))
    return (light + 0.05) / (dark + 0.05)


def lab(rgb: FloatArray) -> FloatArray:
    """CIELAB of linear RGB, white point D65."""
    xyz = TO_XYZ @ rgb / np.array([0.9505, 1.0, 1.089])
    f = np.where(xyz > 216 / 24389, np.cbrt(xyz), (24389 / 27 * xyz + 16) / 116)
    return np.array([116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])])


def difference(a: int, b: int, vision: str) -> float:
    """ΔE (CIE76) of two colours, seen with a kind of vision."""
    seen = [lab(np.clip(VISION[vision] @ linear(colour), 0.0, 1.0)) for colour in (a, b)]
    return float(np.linalg.norm(seen[0] - seen[1]))


def test_a_body_that_touches_nobody_is_grey() -> None:
    assert palette.node_colours(np.array([-1, 0, 1])).tolist() == [palette.GREY, *palette.BODIES[:2]]


def test_single_bodies_take_turns_in_the_hues_and_a_group_has_one() -> None:
    colours = palette.body_colours(np.array([-1] * 9 + [0] * 40))
    hues = [
        tuple(round(c / max(rgb), 1) for c in rgb)
        for rgb in ([(int(colour) >> shift) & 0xFF for shift in (24, 16, 8)] for colour in colours)
    ]
    assert len(set(hues[:6])) == 6, "neighbours differ"
    assert len(set(hues[9:])) == 1 and hues[9] not in hues[:6]


def test_many_single_bodies_share_a_hue() -> None:
    colours = palette.body_colours(np.full(palette.MOST_SINGLE + 1, -1))
    red, blue = colours >> np.uint32(24), (colours >> np.uint32(8)) & 0xFF
    assert np.all(red > blue)


def test_a_few_bodies_have_a_hue_each_and_many_share_that_of_their_group() -> None:
    few = palette.body_colours(np.zeros(5, dtype=np.int64))
    assert len(set(few.tolist())) == 5
    many = palette.body_colours(np.repeat([0, 1], 50))
    blue, red = (many >> np.uint32(8)) & 0xFF, many >> np.uint32(24)
    assert np.all(blue[:50] > red[:50])
    assert np.all(blue[50:] < red[50:])


@pytest.mark.parametrize("vision", VISION)
def test_no_body_has_the_colour_of_a_quantity(vision: str) -> None:
    quantities = [*palette.ARROWS.values(), palette.VERMILION, *map(int, drawing.COLOURS)]
    apart = 30.0 if vision == "normal" else 6.0  # 2.3 is just noticeable; edges have eight levels of one scale
    for body in palette.BODIES:
        assert min(difference(body, each, vision) for each in quantities) >= apart, f"{body:08x}"


@pytest.mark.parametrize("vision", VISION)
def test_bodies_differ_for_colour_blind_readers(vision: str) -> None:
    assert min(difference(a, b, vision) for a, b in combinations(palette.BODIES, 2)) >= 22.0


@pytest.mark.parametrize("theme", palette.PLOT_GROUNDS)
@pytest.mark.parametrize("name", palette.LINES)
def test_curves_stand_out_from_the_ground_of_a_plot(name: str, theme: str) -> None:
    # 3 to 1 is what WCAG 2.1 asks of graphical objects, criterion 1.4.11
    assert contrast(palette.LINES[name], palette.PLOT_GROUNDS[theme]) >= 3.0


@pytest.mark.parametrize("theme", palette.PLOT_GROUNDS)
@pytest.mark.parametrize("colour", [palette.CONTACTS, palette.IMPACTS, palette.FRICTION, palette.SLATE])
def test_curves_in_the_colours_of_arrows_and_edges_stand_out_from_the_ground_of_a_plot(colour: int, theme: str) -> None:
    assert contrast(colour, palette.PLOT_GROUNDS[theme]) >= 3.0


def test_edges_are_shades_of_the_colour_of_contacts_from_dark_to_bright() -> None:
    shades = [lab(linear(int(colour))) for colour in drawing.COLOURS]
    assert np.all(np.diff([light for light, _, _ in shades]) > 4.0), "each level is brighter than the one before"
    hue = [np.degrees(np.arctan2(b, a)) for _, a, b in [*shades, lab(linear(palette.VERMILION))]]
    assert max(hue) - min(hue) < 20.0


@pytest.mark.parametrize("vision", VISION)
def test_curves_differ_for_colour_blind_readers(vision: str) -> None:
    for (one, a), (other, b) in combinations(palette.LINES.items(), 2):
        # 2.3 is just noticeable side by side; curves are thin and apart. Blue and green of Okabe and Ito have 17.
        assert difference(a, b, vision) >= 18.0, f"{one} and {other}"


def test_the_measures_of_colour_are_right() -> None:
    assert contrast(0x000000FF, 0xFFFFFFFF) == pytest.approx(21.0)
    assert contrast(0x777777FF, 0xFFFFFFFF) == pytest.approx(4.48, abs=0.005)  # WebAIM's contrast checker
    assert lab(linear(0xFF0000FF)) == pytest.approx([53.2, 80.1, 67.2], abs=0.1)  # of sRGB red


@pytest.mark.parametrize("theme", ["light", ""])
@pytest.mark.parametrize("name", palette.NAMED)
def test_colours_of_bodies_are_made_legible_on_paper_and_in_plots_without_another_hue(name: str, theme: str) -> None:
    given = palette.NAMED[name]
    (found,) = palette.legible([given], theme).tolist()
    for ground in [palette.PLOT_GROUNDS["light"], *([] if theme else [palette.PLOT_GROUNDS["dark"]])]:
        assert contrast(found, ground) >= 2.95, "3, less the rounding to 8 bits"
    before, after = (np.argsort([(c >> shift) & 0xFF for shift in (24, 16, 8)], stable=True) for c in (given, found))
    assert np.array_equal(before, after)
    assert palette.legible([given], "dark").tolist() == [given]
