"""Two equal spheres fall together under their own gravity and bounce with e = 1/2.

G = m = 1, r = 2, separation 20, from rest. Between bounces the pair is on a degenerate Kepler orbit, so everything is
analytic: the fall takes √(R³/(G M)) (arccos √q + √(q (1 - q))) / √2 with R = 20, M = 2, q = 4/20, the speed of approach
is √(2 G M (1/4 - 1/20)), and each rebound keeps a quarter of the kinetic energy, which sets the next apocentre.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from carom.physics.space import Space
from examples import scene_of

FloatArray = NDArray[np.float64]

BOUNCES = (67.40174, 77.05761, 80.88901, 82.70814)  # s
AT_REST = 84.50126  # s, the limit of the times of all bounces
APOCENTRES = (5.0, 4.210526, 4.050633, 4.012539)


def separations(max_dt: float, target_dx: float, duration: float) -> tuple[FloatArray, FloatArray, Space]:
    bodies = [{"position": [x, 0, 0], "radius": 2.0, "mass": 1.0} for x in (-10, 10)]
    space = Space(
        scene_of(
            bodies,
            gravity={"constant": 1.0},
            contact={"restitution": 0.5},
            time={"duration": duration, "max_dt": max_dt, "target_dx": target_dx},
        )
    )
    frames = list(space.run())
    distance = np.array([np.linalg.norm(frame.position[1] - frame.position[0]) for frame in frames])
    return np.array([frame.time for frame in frames]), distance, space


def test_the_numbers_of_this_file_are_those_of_kepler() -> None:
    q = 4 / 20
    fall = math.sqrt(20**3 / 2) * (math.acos(math.sqrt(q)) + math.sqrt(q * (1 - q))) / math.sqrt(2)
    assert math.isclose(fall, BOUNCES[0], rel_tol=1e-7)
    energy, time = -2 / 20, fall
    for number in range(60):
        kinetic = (energy + 2 / 4) / 4
        energy = kinetic - 2 / 4
        apocentre = -2 / energy
        if number < len(APOCENTRES):
            assert math.isclose(apocentre, APOCENTRES[number], rel_tol=1e-7)
            assert math.isclose(time, BOUNCES[number], rel_tol=1e-7)
        q = 4 / apocentre
        time += 2 * math.sqrt(apocentre**3 / 2) * (math.acos(math.sqrt(q)) + math.sqrt(q * (1 - q))) / math.sqrt(2)
        if apocentre - 4 < 1e-12:
            break
    assert math.isclose(time, AT_REST, rel_tol=1e-7)


def test_the_first_contact_comes_when_kepler_says() -> None:
    # The contact is found at the end of the step in which it happens, so it is late by at most one step.
    _, _, space = separations(max_dt=0.01, target_dx=1e-5, duration=68.0)
    assert space.moments.contacts is not None
    assert 0.0 <= space.moments.contacts.time - BOUNCES[0] <= 0.01


def test_the_apocentres_are_keplers() -> None:
    # A contact found up to a step late is resolved at an overlap up to v dt: the energy of the rebound is wrong by the
    # potential over that depth, so apocentres have an error of first order in dt. 0.6 dt were measured.
    _, distance, _ = separations(max_dt=0.004, target_dx=1e-6, duration=83.5)
    peaks = [
        distance[k]
        for k in range(1, len(distance) - 1)
        if distance[k - 1] < distance[k] >= distance[k + 1] and distance[k] > 4.001
    ]
    assert np.allclose(peaks[:4], APOCENTRES, rtol=0, atol=0.8 * 0.004)


def test_the_pair_is_at_rest_in_the_end() -> None:
    _, distance, space = separations(max_dt=0.01, target_dx=1e-4, duration=200.0)
    assert abs(distance[-1] - 4.0) <= 1e-6
    assert space.energy().translational <= 1e-20


def test_the_bounces_come_when_kepler_says_and_end_when_their_series_does() -> None:
    # A rebound from an overlap up to v dt loses up to g v dt (1 - e²)/(e v) of its speed at the surface, g = 2/16, and
    # the flight that follows is 2/g times that shorter: 3 dt at e = 1/2. Half of it goes on to each later flight. So
    # the bounces are off by up to 0, 3, 7.5 and 12.75 dt, and by one more for the step in which they are found. The
    # series ends when a step sees no approach faster than 2 a dt; 11 bounces come before, each up to 6 dt in the end.
    dt = 0.004
    time, distance, _ = separations(max_dt=dt, target_dx=1e-6, duration=90.0)
    lowest = [k for k in range(1, len(distance) - 1) if distance[k - 1] > distance[k] <= distance[k + 1]]
    assert np.all(np.abs(time[lowest[:4]] - BOUNCES) <= np.array([1.0, 4.0, 8.5, 13.75]) * dt)
    moving = np.flatnonzero(np.abs(distance - 4.0) > 1e-6)
    assert abs(time[moving[-1]] - AT_REST) <= 66 * dt
