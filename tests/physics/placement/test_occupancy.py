"""The grids that hasten random placement accept the same candidates as the search that they replace."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from carom.physics.placement import place, random_placement
from carom.physics.placement import random_placement as occupancy
from carom.physics.placement.neighbours import overlapping_pairs
from carom.scene.load import Scene

CROWDED: dict[str, dict[str, Any]] = {
    "a ball of equal spheres": {
        "group": [{"count": 400, "radius": 0.7, "region": {"radius": 7.9}}],
    },
    "spheres of one octave in a box": {
        "group": [
            {
                "count": 300,
                "radius": {"min": 0.55, "max": 1.0},
                "region": {"shape": "box", "size": [17.0, 18.0, 15.0], "centre": [5.0, -7.0, 3.0]},
            }
        ],
    },
    "spheres of several octaves above a plane, around a body": {
        "body": [{"radius": 2.0, "position": [1.0, 0.0, 0.0]}],
        "plane": [{"point": [0.0, 0.0, -5.0]}],
        "group": [
            {"count": 150, "radius": {"min": 0.3, "max": 1.5}, "region": {"radius": 9.0}},
            {"count": 250, "radius": 0.4, "region": {"shape": "box", "size": [12.0, 12.0, 12.0]}},
        ],
    },
}


@pytest.mark.parametrize("name", CROWDED)
def test_a_start_has_the_same_bits_with_grids_and_without(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = Scene.from_dict({"seed": 5, **CROWDED[name]})
    fast = place(scene)
    monkeypatch.setattr(occupancy.Occupancy, "pays", staticmethod(lambda *_: False))
    assert place(scene).position.tobytes() == fast.position.tobytes()


def test_a_start_inside_a_periodic_box_has_the_same_bits_as_if_images_were_looked_at(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    domain = {"boundary": "periodic", "size": [14.0] * 3}
    group = {"count": 400, "radius": 0.7, "region": {"shape": "box", "size": [14.0] * 3}}
    scene = Scene.from_dict({"seed": 5, "gravity": {"constant": 0.0}, "domain": domain, "group": [group]})
    fast = place(scene)
    monkeypatch.setattr(random_placement, "_is_inside", lambda *_: False)
    assert place(scene).position.tobytes() == fast.position.tobytes()


def test_candidates_touch_what_an_exact_test_of_all_pairs_says() -> None:
    rng = np.random.default_rng(3)
    everywhere, radii = rng.uniform(-5.0, 5.0, (4000, 3)), rng.uniform(0.5, 0.99, 4000)
    taken = occupancy.Occupancy(np.full(3, -5.0), np.full(3, 5.0), radii)
    accepted: list[int] = []
    for k in range(200):
        row = np.array([k])
        if not taken.touches(everywhere[row], radii[row])[0]:
            taken.add(everywhere[row], radii[row])
            accepted.append(k)
    assert len(accepted) > 50
    assert len(overlapping_pairs(everywhere[accepted], radii[accepted])) == 0
    candidates = np.arange(200, 4000)
    found = taken.touches(everywhere[candidates], radii[candidates])
    distance = np.linalg.norm(everywhere[candidates, None] - everywhere[accepted], axis=2)
    expected = (distance <= radii[candidates, None] + radii[accepted]).any(axis=1)
    assert found.tolist() == expected.tolist()
    assert 0 < expected.sum() < len(expected)


@pytest.mark.slow
def test_a_hundred_thousand_spheres_fill_three_tenths_of_a_ball() -> None:
    group = {"count": 100_000, "radius": 1.0, "region": {"radius": (1e5 / 0.3) ** (1 / 3)}}
    start = place(Scene.from_dict({"seed": 1, "group": [group]}))
    assert len(overlapping_pairs(start.position, start.radius)) == 0
