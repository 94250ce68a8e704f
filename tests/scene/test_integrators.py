"""The one list of integrators: what follows from it, and the docs that repeat it."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from carom.scene.integrators import INTEGRATORS

DOCS = Path(__file__).parents[2] / "docs"


@pytest.mark.parametrize("name", [name for name, each in INTEGRATORS.items() if not each.controls_error])
def test_kicks_and_drifts_of_a_step_each_add_up_to_the_step(name: str) -> None:
    substeps = INTEGRATORS[name].substeps
    assert sum(step.drift for step in substeps) == pytest.approx(1.0, abs=1e-15)
    assert sum(step.before + step.after for step in substeps) == pytest.approx(1.0, abs=1e-15)


def test_contacts_can_rest_only_where_the_last_forces_are_those_of_the_final_positions() -> None:
    assert [name for name, each in INTEGRATORS.items() if not each.holds_contacts] == [
        "leapfrog-dkd",
        "gauss-radau15",
        "wisdom-holman",
    ]


def test_only_a_single_forward_drift_has_room_for_impacts_on_the_way() -> None:
    assert [name for name, each in INTEGRATORS.items() if each.drifts_once] == ["euler", "leapfrog"]
    assert [name for name, each in INTEGRATORS.items() if each.steps_back] == ["yoshida4"]


def test_the_table_of_the_docs_is_that_of_the_code() -> None:
    text = (DOCS / "physics.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| `([\w-]+)` \| [^|]*[^|]*\|\s*(\d+) \| (\d) \|", text, re.MULTILINE)
    assert rows == [(each.name, str(each.order), str(each.force_sums)) for each in INTEGRATORS.values()]
