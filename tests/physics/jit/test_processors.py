"""The same bits on any processor and number of threads: SSE2 alone beside all that this one has."""

from __future__ import annotations

import ast
import os
import subprocess
import sys
from pathlib import Path

import pytest

import carom
from other_processor import OtherProcessor

METHODS = ("direct", "tree", "fast-multipole")
STEPS = 20
# Enough bodies that gravity is shared among threads, colliding from the start.
RUN = f"""
import sys
from carom.physics.space import Space
from carom.scene.load import Scene

group = {{
    "count": 2200,
    "radius": {{"min": 0.2, "max": 0.5}},
    "region": {{"radius": 7.5}},
    "velocity": {{"dispersion": 1.0}},
}}
for method in {METHODS}:
    gravity = {{"constant": 0.01, "method": method}}
    space = Space(Scene.from_dict({{"gravity": gravity, "time": {{"cfl": 0.2}}, "group": [group]}}), int(sys.argv[1]))
    for step in range({STEPS}):
        space.compute_dynamics(step)
    print(space.fingerprint())
"""


def fingerprints(threads: int, environment: dict[str, str] | None = None) -> list[str]:
    """Run the cloud in a process of its own; return its last fingerprint by each method."""
    command = [sys.executable, "-c", RUN, str(threads)]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    return done.stdout.split()


@pytest.mark.nightly
@pytest.mark.slow
def test_a_cloud_ends_with_the_same_bits_on_any_processor_and_number_of_threads(
    other_processor: OtherProcessor,
) -> None:
    alone = fingerprints(1)
    assert len(set(alone)) == len(METHODS)
    assert fingerprints(4) == alone
    assert fingerprints(2, other_processor.environment) == alone


PLANES = """
import json
from dataclasses import asdict
from carom.physics.space import Space
from carom.scene.load import Scene

plane = {"normal": [0.3, -0.5, 0.9], "point": [0.1, 0.2, 0.3]}
group = {"count": 40, "radius": {"min": 0.2, "max": 0.5}, "region": {"radius": 3.5, "centre": [0.0, 0.0, 5.0]}}
document = {"gravity": {"uniform": [0.1, 0.2, -9.81]}, "plane": [plane], "group": [group], "time": {"fixed_dt": 0.01}}
space = Space(Scene.from_dict(document), 1)
for _ in space.run(until=1.5):
    pass
print(space.fingerprint(), json.dumps(asdict(space.frame().books)["energy"]), space.frame().books.momentum)
"""


@pytest.mark.slow
def test_the_linear_algebra_of_another_processor_changes_no_bit_of_state_and_books() -> None:
    # OpenBLAS chooses its kernels by the processor; those of Prescott have neither AVX nor fused multiply-add.
    found = set()
    for core in ("", "Prescott", "Haswell"):
        environment = os.environ | ({"OPENBLAS_CORETYPE": core} if core else {})
        done = subprocess.run(
            [sys.executable, "-c", PLANES], env=environment, capture_output=True, text=True, check=True
        )
        found.add(done.stdout)
    assert len(found) == 1


def test_the_physics_leaves_no_sum_to_blas() -> None:
    """Matrix products round as the processor's BLAS does, and recordings would replay on similar machines alone."""
    source = Path(carom.__file__).parent
    files = [*(source / "physics").rglob("*.py"), *(source / "scene").glob("*.py")]
    files.remove(source / "physics" / "reference_api.py")  # the arithmetic of the seed; no recording comes from it
    assert len(files) > 100
    products = [
        f"{file.relative_to(source)}:{node.lineno}"
        for file in files
        for node in ast.walk(ast.parse(file.read_text()))
        if (isinstance(node, ast.BinOp) and isinstance(node.op, ast.MatMult))
        or (isinstance(node, ast.Attribute) and node.attr in ("dot", "vdot", "inner", "matmul", "tensordot"))
    ]
    assert products == []
