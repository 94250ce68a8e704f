"""The same bits on any processor and number of threads: SSE2 alone beside all that this one has."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

STEPS = 200
# Enough bodies that gravity is shared among threads, colliding from the start.
RUN = f"""
import sys
from carom.physics.space import Space
from carom.scene.schema import Scene

group = {{
    "count": 2200,
    "radius": {{"min": 0.2, "max": 0.5}},
    "region": {{"radius": 7.5}},
    "velocity": {{"dispersion": 1.0}},
}}
gravity = {{"constant": 0.01, "method": sys.argv[1]}}
scene = Scene.from_dict({{"gravity": gravity, "time": {{"cfl": 0.2}}, "group": [group]}})
for threads in sys.argv[2:]:
    space = Space(scene, int(threads))
    for step in range({STEPS}):
        space.compute_dynamics(step)
    print(space.fingerprint())
"""


def fingerprints(method: str, threads: list[int], **environment: str) -> list[str]:
    command = [sys.executable, "-c", RUN, method, *map(str, threads)]
    done = subprocess.run(command, env=os.environ | environment, capture_output=True, text=True, check=True)
    return done.stdout.split()


@pytest.mark.slow  # it compiles every kernel for another processor
@pytest.mark.parametrize("method", ["direct", "tree", "fast-multipole"])
def test_200_steps_end_with_the_same_bits_on_any_processor_and_number_of_threads(method: str) -> None:
    here = fingerprints(method, [1, 2, 4])
    elsewhere = fingerprints(method, [2], NUMBA_CPU_NAME="generic", NUMBA_CPU_FEATURES="")
    assert len(here) == 3
    assert len({*here, *elsewhere}) == 1
