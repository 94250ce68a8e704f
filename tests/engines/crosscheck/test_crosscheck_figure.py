"""The engines can be distinguished in the figure of a crosscheck."""

from __future__ import annotations

from carom.engines.crosscheck.crosscheck_figure import OWN_COLOUR, colours_of


def test_engines_measured_by_an_earlier_command_keep_colours_of_their_own() -> None:
    colours = colours_of(["mujoco", "", "mujoco", "pybullet", "box3d"])
    assert colours[""] == OWN_COLOUR
    assert len(set(colours.values())) == len(colours) == 4
