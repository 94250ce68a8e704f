"""Kernels that different processes compiled do not serve each other's records: their symbols differ."""

from __future__ import annotations

import os
import subprocess
import sys
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numba
import numpy as np
import pytest

from carom.physics.jit.decorators import kernel
from carom.physics.jit.inside import bytecode, layout_digest

TERMS = 300  # of a function that is too long to be inlined by LLVM, so that it is linked by its symbol
MODULE = f"""
import sys
import numpy as np
from carom.physics.jit.decorators import kernel

@kernel
def long_sum(records):
    total = 0.0
{"".join(f"    total = total * 0.5 + records[{k} % records.size]['mass']{chr(10)}" for k in range(TERMS))}
    return total

def made(factor):
    def scaled_sum(records):
        total = 0.0
{"".join(f"        total = total * factor + records[{k} % records.size]['mass']{chr(10)}" for k in range(TERMS))}
        return total
    return kernel(scaled_sum)

@kernel
def first(records):
    return long_sum(records)

@kernel
def second(records):
    return long_sum(records)

half, quarter = made(0.5), made(0.25)

@kernel
def third(records):
    return half(records)

@kernel
def fourth(records):
    return quarter(records)

KERNELS = {{"first": first, "second": second, "third": third, "fourth": fourth}}
LAYOUTS = {{"mass first": [("mass", "f8"), ("radius", "f8")], "radius first": [("radius", "f8"), ("mass", "f8")]}}
for asked in sys.argv[1:]:
    name, layout = asked.split(":")
    records = np.zeros(3, dtype=LAYOUTS[layout])
    records["mass"], records["radius"] = 1.0, -1000.0
    print(KERNELS[name](records))
"""


def sums(folder: Path, *asked: str) -> list[float]:
    """Run kernels over layouts in one new process, with the folder's cache."""
    script = folder / "kernels.py"
    script.write_text(MODULE)
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(folder / "cache")}
    done = subprocess.run([sys.executable, script, *asked], env=environment, check=True, capture_output=True, text=True)
    return [float(line) for line in done.stdout.split()]


def geometric(ratio: float) -> float:
    """Return the sum of the terms of the module's kernels for masses of 1 kg."""
    return (1.0 - ratio**TERMS) / (1.0 - ratio)


def test_kernels_of_two_processes_over_two_layouts_of_records_each_read_their_own(tmp_path: Path) -> None:
    asked = ("first:mass first", "second:radius first")
    for each in asked:  # each fills the cache alone, and numbers its layouts and functions from the same start
        assert sums(tmp_path, each) == [pytest.approx(geometric(0.5))]
    assert sums(tmp_path, *asked) == [pytest.approx(geometric(0.5))] * 2


@pytest.mark.slow  # compiles for half a minute
def test_kernels_of_two_processes_that_one_factory_made_each_call_their_own(tmp_path: Path) -> None:
    right = {"third:mass first": geometric(0.5), "fourth:mass first": geometric(0.25)}
    for each, value in right.items():
        assert sums(tmp_path, each) == [pytest.approx(value)]
    assert sums(tmp_path, *right) == [pytest.approx(value) for value in right.values()]


@kernel
def mass_of(records: Any) -> float:
    return float(records[0]["mass"])


def test_a_symbol_contains_the_layout_of_its_records_and_the_number_of_its_process() -> None:
    records = np.zeros(1, dtype=[("mass", "f8"), ("radius", "f8")])
    mass_of(records)
    compiled: Any = mass_of
    typeof: Any = numba.typeof
    (result,) = compiled.overloads.values()
    symbol = result.fndesc.mangled_name
    assert layout_digest(typeof(records).dtype) in symbol
    assert f"v{result.fndesc.uid}" in symbol and result.fndesc.uid > 2**32


def next_number() -> int:
    return int(next(bytecode.FunctionIdentity._unique_ids))


def test_a_forked_process_numbers_its_functions_from_another_start() -> None:
    with get_context("fork").Pool(1) as workers:
        assert abs(workers.apply(next_number) - next_number()) > 2**32
