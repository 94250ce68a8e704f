"""The one list of integrators: what follows from it, and the docs that repeat it."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest

from carom import registry
from carom.errors import SceneError
from carom.plan.auto import integrator
from carom.scene.extensions import extensions_of
from carom.scene.integrators import INTEGRATORS, Integrator, Substep
from carom.scene.load import Scene

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


def test_a_scene_may_name_a_sequence_of_substeps_of_an_installed_package(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    (tmp_path / "given_integrators.py").write_text(
        "from carom.extend import Integrator, Substep\n"
        "ADJOINT = Integrator('adjoint-euler', 'Euler the other way round', 1, (Substep(0.0, 1.0, 1.0),))\n"
        "OTHER = 7\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    given = {
        name: (registry.PartOrigin(f"given_integrators:{attribute}", "given", "1.0"),)
        for name, attribute in (("adjoint-euler", "ADJOINT"), ("other", "OTHER"))
    }
    monkeypatch.setattr(registry, "_installed", lambda: {"integrators": given})
    sections: dict[str, Any] = {"body": [{"radius": 1.0, "mass": 1.0}]}
    scene = Scene.from_dict(sections | {"time": {"integrator": "adjoint-euler"}})
    assert integrator(scene) == Integrator("adjoint-euler", "Euler the other way round", 1, (Substep(0.0, 1.0, 1.0),))
    assert extensions_of(scene) == {"integrators.adjoint-euler": "given 1.0"}, "a recording names its package"
    with pytest.raises(
        SceneError, match=r"the package given 1[.]0 cannot be loaded: .* type int instead of Integrator"
    ):
        Scene.from_dict(sections | {"time": {"integrator": "other"}})
    with pytest.raises(SceneError, match="must be 'auto', 'euler'"):
        Scene.from_dict(sections | {"time": {"integrator": "leapfrgo"}})
