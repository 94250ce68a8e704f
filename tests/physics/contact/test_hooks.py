"""Optional parts of a step: the core names none, and calls their hooks in the order of `OptionalPart`."""

from __future__ import annotations

import re
import sys
from importlib.machinery import ModuleSpec
from inspect import signature
from pathlib import Path
from types import ModuleType

import pytest

import carom
from carom.physics.contact.hooks import Hooks, OptionalPart, PresentStep
from carom.physics.space import Space
from carom.plan.features import require
from carom.plan.step_parts import STEP_PARTS, StepPart, required
from carom.scene.load import Scene
from carom.scene.scene_file import bundled_scenes

PHYSICS = Path(carom.__file__).parent / "physics"
CORE = ("step.py", "contact/pipeline.py", "diagnostics/bookkeeper.py")
PARTS = re.compile(
    "sleep|shear|piston|wall|translat|guided|damp|drag|guard|event_d|contact\\.events|impact_time|time_of_impact|time-of-impact"
    "|release|passage|admit|outlet|path_work|contact\\.rolling|\\btap|_tap|Tap",
    re.IGNORECASE,
)
INSTEAD = {"kick_before", "kick_after", "move", "wrap"}  # they replace a stage of the step
STEPWISE = [name for name in Hooks._fields if [*signature(getattr(OptionalPart, name)).parameters] == ["self", "step"]]
IN_STEP = [name for name in STEPWISE if name not in INSTEAD]


@pytest.mark.parametrize("module", CORE)
def test_the_core_of_a_step_names_no_optional_part(module: str) -> None:
    lines = (PHYSICS / module).read_text(encoding="utf-8").splitlines()
    assert not [line for line in lines if PARTS.search(line)]


ORDER = """\
asteroid-belt: time-of-impact
billiards: time-of-impact, plane-guard
bouncing-ball: time-of-impact, plane-guard
chute: time-of-impact, plane-guard
cloud-collapse: time-of-impact
dense-shear: sheared-contacts
drum: walls, time-of-impact, plane-guard
elastic-gas: time-of-impact
five-materials: time-of-impact, plane-guard
heap: time-of-impact, plane-guard
hopper: walls, time-of-impact, plane-guard
incline: time-of-impact, plane-guard
marbles-in-a-box: time-of-impact, plane-guard
newtons-cradle: time-of-impact
piston: walls, time-of-impact, plane-guard
planet-with-gravel: time-of-impact
rack-break: time-of-impact
rubble-collision: time-of-impact
shaker: walls, time-of-impact, plane-guard
shear-cell: time-of-impact
steady-hopper: release, walls, time-of-impact, plane-guard
two-spheres: time-of-impact
"""


def test_the_parts_of_the_bundled_scenes_and_their_order() -> None:
    scenes = {name: Scene.load(name) for name in sorted(bundled_scenes())}
    found = {name: ", ".join(required(scene, require(scene), recorded=False)) for name, scene in scenes.items()}
    assert "".join(f"{name}: {parts}\n" for name, parts in found.items() if parts) == ORDER


def test_every_hook_of_a_step_is_called_in_the_order_of_its_definition(monkeypatch: pytest.MonkeyPatch) -> None:
    """A part is added by a module and a row."""
    called: list[str] = []

    def noting(name: str) -> object:
        return lambda self, step: called.append(name)

    noted = type("Noted", (OptionalPart,), {name: noting(name) for name in IN_STEP})
    module = ModuleType("noted_part")
    module.__spec__ = ModuleSpec("noted_part", None)
    module.make = lambda contacts: noted()  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "noted_part", module)
    row = StepPart("noted_part:make", lambda scene, needs, recorded: True, (), lambda scene: "")
    monkeypatch.setitem(STEP_PARTS, "noted", row)
    ball = {"body": [{"position": [0, 0, 1]}], "plane": [{}], "gravity": {"uniform": [0, 0, -9.81]}}
    space = Space(Scene.from_dict({"title": "", **ball, "time": {"fixed_dt": 0.01}}), 1)
    space.compute_dynamics(1)  # the ball is held from the second step on
    called.clear()
    space.compute_dynamics(2)
    once = [name for name in IN_STEP if name not in ("struck", "kicked")]  # nothing strikes; a step has two kicks
    assert [name for name in called if name != "kicked"] == once
    assert called.count("kicked") == 2


def test_the_lists_of_hooks_have_only_parts_that_implement_them() -> None:
    class Ends(OptionalPart):
        def end(self, step: PresentStep) -> None: ...

    assert not any(Hooks.of([OptionalPart()]))
    assert [name for name, hooks in Hooks.of([Ends(), OptionalPart()])._asdict().items() if hooks] == ["end"]
