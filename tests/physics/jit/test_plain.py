"""Plain kernels, which use only documented features of Numba, have the bits of the optimised ones."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numba
import numpy as np
import pytest

from carom.arrays import FloatArray, IntArray
from carom.physics.forces.gravity.fast_multipole import taylor
from carom.physics.jit import instructions
from carom.physics.jit.vectors import WIDTH

# Contacts in colours, at rest and in flight, by every method; direct sums, trees and orbits. No other scene has more.
SCENES = ("golden/heap", "golden/orbits", "golden/planets")
FIRST = SCENES[1]  # compiles in a fifth of the time of the contacts
ROOT = Path(__file__).parents[3]


@pytest.mark.slow  # it compiles all kernels of a scene
@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[] if name == FIRST else [pytest.mark.nightly]) for name in SCENES]
)
def test_plain_kernels_have_the_stored_bits(name: str, tmp_path: Path) -> None:
    # No optimisation of the compiler moves a bit: with few of them it takes a fraction of the time.
    quick = {"NUMBA_OPT": "1", "NUMBA_CACHE_DIR": str(tmp_path)}
    test = f"tests/golden/test_golden.py::test_the_bits_of_a_scene_are_the_stored_ones_by_every_method[{name}]"
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-n", "0", "-p", "no:cacheprovider", test],
        env=os.environ | quick | {"CAROM_PLAIN": "1"},
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout


LACKING = """
import numba.core.cgutils
del numba.core.cgutils.for_range_slice
import numpy as np
from carom.physics.jit import inside
from carom.physics.jit.decorators import kernel
from carom.physics.jit.instructions import atomic_add
from carom.physics.jit.team import Team

@kernel
def count(words) -> int:
    return atomic_add(words, 0, 5)

assert inside.PLAIN and Team(4).size == 1
print(count(np.array([3])), inside.MISSING)
"""


def test_kernels_are_plain_where_numba_lacks_a_part_and_a_warning_names_it() -> None:
    done = subprocess.run([sys.executable, "-c", LACKING], capture_output=True, text=True, check=False)
    assert done.stdout == "3 ['numba.core.cgutils.for_range_slice']\n", done.stderr
    assert "lacks numba.core.cgutils.for_range_slice, so carom uses plain kernels" in done.stderr


@numba.njit(error_model="numpy")
def use_instructions(words: IntArray) -> tuple[int, int, bool, bool, int, int]:
    added, loaded = instructions.atomic_add(words, 0, 5), instructions.atomic_load(words, 1)
    instructions.atomic_store(words, 2, 7)
    instructions.atomic_max(words, 3, 9)
    instructions.atomic_max(words, 4, -9)
    replaced = instructions.atomic_replace(words, 5, 0, 4)
    kept = instructions.atomic_replace(words, 6, 1, 4)
    return added, loaded, replaced, kept, instructions.lowest_bit(np.uint64(40)), instructions.lowest_bit(np.uint64(0))


@numba.njit(error_model="numpy")
def use_plain_forms(words: IntArray) -> tuple[int, int, bool, bool, int, int]:
    added, loaded = instructions._add(words, 0, 5), instructions._load(words, 1)
    instructions._store(words, 2, 7)
    instructions._raise(words, 3, 9)
    instructions._raise(words, 4, -9)
    replaced = instructions._replace(words, 5, 0, 4)
    kept = instructions._replace(words, 6, 1, 4)
    return added, loaded, replaced, kept, instructions._lowest(np.uint64(40)), instructions._lowest(np.uint64(0))


def test_each_instruction_does_what_its_plain_form_does() -> None:
    words, plain = np.array([1, 2, 3, 4, 5, 0, 0]), np.array([1, 2, 3, 4, 5, 0, 0])
    assert use_instructions(words) == use_plain_forms(plain) == (1, 2, True, False, 3, 64)
    assert words.tolist() == plain.tolist() == [6, 2, 7, 9, 5, 4, 0]


@numba.njit(error_model="numpy")
def expand(poles: Any, boxes: Any, sums: Any, local: Any, x: Any, m: Any, lanes: Any) -> None:
    taylor.attract(poles, boxes, 1, (0.3, -0.2, 0.1), 0.7, 1e-3, sums)
    taylor.evaluate(local, 1, 0.1, 0.2, -0.3, 0.7, lanes)
    taylor.attract_bodies(x, m, 2, 19, 0.0, lanes)


@numba.njit(error_model="numpy")
def expand_one_by_one(poles: Any, boxes: Any, sums: Any, local: Any, x: Any, m: Any, lanes: Any) -> None:
    taylor._attract_one_by_one(poles, boxes, 1, (0.3, -0.2, 0.1), 0.7, 1e-3, sums)
    taylor._evaluate_one_by_one(local, 1, 0.1, 0.2, -0.3, 0.7, lanes)
    taylor._attract_bodies_one_by_one(x, m, 2, 19, 0.0, lanes)


@pytest.mark.slow  # it compiles the series of the fast multipoles
def test_multipoles_of_eight_boxes_have_the_bits_of_one_box_after_another(seed: int) -> None:
    found: list[tuple[FloatArray, FloatArray]] = []
    for run in (expand, expand_one_by_one):
        rng = np.random.default_rng(seed)
        poles, boxes = rng.normal(size=(20, taylor.POLES)), rng.integers(20, size=9)
        sums, local = rng.normal(size=taylor.LOCAL * WIDTH), rng.normal(size=(3, taylor.LOCAL + 3))
        x, m, lanes = rng.normal(size=(3, 20)), rng.random(20), rng.normal(size=(7, WIDTH))
        lanes[:3, 0] = x[:, 5]  # a body does not attract itself
        run(poles, boxes, sums, local, x, m, lanes)
        found.append((sums, lanes))
    for one, other in zip(*found, strict=True):
        assert one.tobytes() == other.tobytes(), f"seed {seed}"
