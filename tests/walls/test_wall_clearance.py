"""Walls that no body can touch, that enclose none, or that meet as they move are refused in one sentence."""

from __future__ import annotations

from typing import Any

import pytest

from carom import Scene
from carom.errors import SceneError
from carom.physics.placement.initial_state import place

FLOOR = {"point": [0, 0, 0], "normal": [0, 0, 1]}
LID = {"name": "lid", "disc": {"radius": 1.0, "centre": [0, 0, 1.5]}}
TUBE = {"cylinder": {"radius": 1.0}}
BALL = {"radius": 0.1, "mass": 1.0, "position": [0.0, 0.0, 0.5]}


def place_in(duration: float = 2.0, **sections: Any) -> None:
    """Place the bodies of a scene."""
    scene = {"gravity": {"constant": 0.0}, "body": [BALL], "time": {"duration": duration}} | sections
    place(Scene.from_dict(scene))


def moving(solid: dict[str, Any], **motion: Any) -> dict[str, Any]:
    """Return a plane or wall with a motion."""
    return solid | {"motion": motion}


REFUSED: dict[str, tuple[dict[str, Any], str]] = {
    "a piston that runs into the floor": (
        {"plane": [FLOOR], "wall": [TUBE, moving(LID, velocity=[0, 0, -1])]},
        r"lid meets plane 0 at t = 1\.5",
    ),
    "a floor that rises through a plate at rest": (
        {"plane": [moving(FLOOR, times=[0.5], velocities=[[0, 0, 2]])], "wall": [LID]},
        r"plane 0 meets lid at t = 1\.2",
    ),
    "plates that pass through each other": (
        {"wall": [LID, moving({"disc": {"radius": 0.5, "centre": [0, 0, 2]}}, velocity=[0, 0, -1])]},
        r"disc 1 meets lid at t = 0\.5",
    ),
    "a hole that closes": (
        {
            "wall": [
                {"rectangle": {"centre": [1, 0, 0], "side": [1, 0, 0], "other_side": [0, 1, 0]}},
                moving(
                    {"rectangle": {"centre": [-1, 0, 0], "side": [1, 0, 0], "other_side": [0, 1, 0]}},
                    velocity=[0.8, 0, 0],
                ),
            ]
        },
        r"rectangle 1 meets rectangle 0 at t = 1\.25",
    ),
    "a plate that leaves its tube": (
        {"wall": [TUBE, moving({"disc": {"radius": 0.3, "centre": [0, 0, 2]}}, velocity=[1, 0, 0])]},
        r"disc 1 meets cylinder 0 at t = 0\.7",
    ),
    "planes that leave no space between them": (
        {"plane": [FLOOR, moving({"point": [0, 0, 1], "normal": [0, 0, -1]}, velocity=[0, 0, -0.8])], "wall": [TUBE]},
        r"plane 1 meets plane 0 at t = 1\.25",
    ),
    "a plane that leaves no space in a sphere": (
        {
            "plane": [moving({"point": [0, 0, -1], "normal": [0, 0, 1]}, velocity=[0, 0, 1.5])],
            "wall": [{"sphere": {"radius": 1.0}}],
        },
        r"plane 0 meets sphere 0 at t = 1\.3",
    ),
    "a plate behind a plane": ({"plane": [FLOOR], "wall": [{"disc": {"radius": 1, "centre": [0, 0, -1]}}]}, "behind"),
    "a plate outside of a tube": (
        {"wall": [TUBE, {"disc": {"radius": 1, "centre": [3, 0, 0]}}]},
        "lies behind cylinder",
    ),
    "a body outside of a tube": (
        {"wall": [{"cylinder": {"radius": 1.0, "point": [5, 0, 0]}}]},
        "outside of cylinder 0",
    ),
    "a body outside of a tube that may overlap": (
        {"wall": [{"sphere": {"radius": 0.2}}], "contact": {"allow_overlap": True}},
        "outside of sphere 0",
    ),
    "a body across a plate": ({"wall": [{"disc": {"radius": 1, "centre": [0, 0, 0.45]}}]}, "overlaps disc 0"),
}


@pytest.mark.slow  # kernels for walls are compiled for seconds
@pytest.mark.parametrize("name", REFUSED)
def test_walls_that_leave_no_space_are_refused(name: str) -> None:
    sections, message = REFUSED[name]
    with pytest.raises(SceneError, match=message) as raised:
        place_in(**sections)
    assert "\n" not in str(raised.value)


BOX = [
    FLOOR,
    *({"point": [x, y, 0], "normal": [-x, -y, 0]} for x, y in ((1, 0), (-1, 0), (0, 1), (0, -1))),
]
SQUARE = {"rectangle": {"centre": [0, 0, 1.5], "side": [2, 0, 0], "other_side": [0, 2, 0]}}

ACCEPTED: dict[str, dict[str, Any]] = {
    "a box of planes with a lid that fits": {"plane": BOX, "wall": [moving(SQUARE, velocity=[0, 0, -0.5])]},
    "a lid that ends on the floor": {"plane": BOX, "wall": [moving(SQUARE, velocity=[0, 0, -0.75])]},
    "a tube with an end plane and a piston": {
        "plane": [FLOOR],
        "wall": [TUBE, moving(LID, amplitude=[0, 0, 0.5], frequency=3.0)],
    },
    "a funnel in a tube that move together": {
        "wall": [
            moving(solid, amplitude=[0.5, 0, 0], frequency=2.0)
            for solid in (TUBE, {"cone": {"radius": 0.2, "end_radius": 1.0, "height": 0.3, "point": [0, 0, -1]}})
        ]
    },
    "a drum that rotates between plates": {
        "wall": [
            moving(TUBE, rotation=2.0),
            *({"disc": {"radius": 1.1, "centre": [0, 0, z]}} for z in (-1.0, 1.0)),
        ]
    },
    "plates that cross at rest": {
        "wall": [
            {"rectangle": {"centre": [0, 0, 0], "side": side, "other_side": [0, 3, 0]}}
            for side in ([3, 0, 0], [0, 0, 0.5])
        ],
        "body": [BALL | {"position": [1.0, 0.0, 1.0]}],
    },
    "a plate that turns back in time": {
        "plane": [FLOOR],
        "wall": [TUBE, moving(LID, times=[0, 1.4], velocities=[[0, 0, -1], [0, 0, 1]])],
    },
}


@pytest.mark.slow  # kernels for walls are compiled for seconds
@pytest.mark.parametrize("name", ACCEPTED)
def test_walls_that_leave_space_are_accepted(name: str) -> None:
    place_in(**ACCEPTED[name])
