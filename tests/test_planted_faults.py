"""The planted faults stand in the source as it is: each text once, with faults in every package."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

sys.path.append(str(Path(__file__).parents[1] / "benchmarks"))
from planted_faults import FAULTS, SOURCE, PlantedFault


@pytest.mark.parametrize("fault", FAULTS, ids=lambda fault: f"{fault.file} {fault.right}"[:80])
def test_the_text_that_a_fault_replaces_stands_once_in_its_file(fault: PlantedFault) -> None:
    assert (SOURCE / fault.file).read_text(encoding="utf-8").count(fault.right) == 1 and fault.right != fault.wrong


def test_there_are_faults_in_every_package() -> None:
    packages = {path.parent.name for path in SOURCE.glob("*/__init__.py")}
    assert len(FAULTS) >= 60 and {fault.file.partition("/")[0] for fault in FAULTS} >= packages
