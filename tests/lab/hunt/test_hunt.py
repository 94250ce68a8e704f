"""The hunt for scenes that break a law."""

from __future__ import annotations

import contextlib
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from carom.errors import SceneError
from carom.lab.hunt.hunt import LAWS, Hunt, Miss, by_default, laws_of
from carom.lab.hunt.random_scenes import Drawn, drawn
from carom.lab.shrink.trials import OutOfTime
from carom.physics.diagnostics.bookkeeper import BalanceAudit
from carom.physics.placement import place
from carom.physics.space import Space
from carom.scene.load import Scene, scene_from_dict
from carom_command import carom


def test_most_drawn_scenes_are_valid_and_each_law_applies_to_some() -> None:
    laws: list[set[str]] = []
    for index in range(60):
        one = drawn(0, index)
        with contextlib.suppress(SceneError):
            laws.append({law.name for law in laws_of(scene_from_dict(one.document), one.kind)})
    assert len(laws) > 40
    assert set().union(*laws) == {law.name for law in LAWS}


def test_the_same_seed_draws_the_same_scene() -> None:
    assert drawn(3, 4) == drawn(3, 4) != drawn(3, 5)


def test_every_draw_is_a_document_and_some_have_planes_that_move() -> None:
    planes = [plane for index in range(400) for plane in drawn(1, index).document.get("plane", [])]
    assert any("motion" in plane for plane in planes)


def test_some_draws_have_bodies_that_enter_and_leave_and_most_of_them_are_valid() -> None:
    drawn_ones = [drawn(1, index).document for index in range(400)]
    pours = [one for one in drawn_ones if any("release" in group for group in one.get("group", []))]
    assert len(pours) > 15 and {"inlet", "out"} == {each["to"] for one in pours for each in one.get("outlet", [])}
    refused = 0
    for one in pours:
        try:
            scene = scene_from_dict(one)
            place(scene)
            names = {law.name for law in laws_of(scene, "")}
            assert {"ledger", "replay", "impulses"} <= names and not {"arrays", "mirror"} & names
        except SceneError:
            refused += 1
    assert refused < 0.3 * len(pours)


@pytest.mark.slow
def test_a_fault_is_found_shrunk_and_filed_with_its_recording(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("carom.lab.hunt.hunt.drawn", lambda seed, index: Drawn(meeting(index)))
    book = BalanceAudit.book
    monkeypatch.setattr(BalanceAudit, "book", lambda audit, work: book(audit, np.asarray(work) * [0.0, 1.0, 1.0]))
    made = carom("hunt", "--seed", "7", "--scenes", "2", "-o", "found", "--json", cwd=tmp_path)
    assert made.returncode == 1
    tally: dict[str, Any] = json.loads(made.stdout)
    first = next(miss for miss in tally["misses"] if miss["law"] == "ledger")
    assert first["bodies"] <= 2 and (tmp_path / first["file"]).with_suffix(".rrd").exists()
    assert "# carom hunt --seed 7 --from 0 --scenes 1" in (tmp_path / first["file"]).read_text()
    assert [miss["file"] for miss in tally["misses"] if miss["law"] == "ledger"][1:] == [None]


@pytest.mark.slow
def test_a_bounce_that_depends_on_the_step_is_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A planted fault: impacts of runs with shorter steps are elastic."""
    monkeypatch.setattr("carom.lab.hunt.hunt.drawn", lambda seed, index: Drawn(meeting(index)))
    made = Space.__init__

    def planted(
        space: Space, scene: Scene, threads: Any = None, start: Any = None, stride: float = 1.0, **other: Any
    ) -> None:
        elastic = scene.model_copy(update={"contact": scene.contact.model_copy(update={"restitution": 1.0})})
        made(space, elastic if stride < 1.0 else scene, threads, start, stride, **other)

    monkeypatch.setattr(Space, "__init__", planted)
    done = carom("hunt", "--seed", "7", "--scenes", "1", "-o", "found", "--json", cwd=tmp_path)
    misses = json.loads(done.stdout)["misses"]
    assert done.returncode == 1 and [miss["law"] for miss in misses] == ["shorter steps"]
    assert misses[0]["bodies"] == 2 and " with shorter steps" in misses[0]["said"]


def test_a_scene_is_refined_with_the_default_method() -> None:
    drawn_scene = meeting(0)
    drawn_scene["time"] |= {"fixed_dt": 0.5, "max_dt": 1.0}
    drawn_scene["contact"] |= {"timing": "end-of-step"}
    changed = by_default(drawn_scene)
    assert changed is not None and changed["time"] == {"duration": 1.5}
    assert changed["contact"] == {"static_friction": 0.0} and drawn_scene["time"]["fixed_dt"] == 0.5
    assert by_default(drawn_scene | {"contact": {"allow_overlap": True}}) is None


def meeting(index: int) -> dict[str, Any]:
    """Three spheres; two of them meet head on."""
    bodies = [{"name": f"ball {k}", "position": [3.0 * k, 0.0, 0.0], "velocity": [-k, 0.0, 0.0]} for k in range(3)]
    return {
        "body": bodies,
        "gravity": {"constant": 0.0},
        "contact": {"static_friction": 0.0},
        "time": {"duration": 1.5 + index},
        "record": {"every": "step"},
    }


@pytest.mark.nightly
@pytest.mark.slow
def test_a_sound_engine_breaks_no_law_in_a_few_scenes(tmp_path: Path) -> None:
    made = carom("hunt", "--seed", "1", "--scenes", "9", "-o", "found", "--json", cwd=tmp_path)
    assert made.returncode == 0 and not json.loads(made.stdout)["misses"], made.stdout


def test_a_folder_that_cannot_be_made_is_refused_before_the_hunt(tmp_path: Path) -> None:
    (tmp_path / "taken").write_text("mine", encoding="utf-8")
    made = carom("hunt", "--seed", "1", "--scenes", "1", "-o", "taken", cwd=tmp_path)
    assert made.returncode == 2 and not made.stdout
    assert made.stderr == "carom: taken: is not a folder, but carom needs a folder of that name; move it\n"


def test_a_hunt_without_a_miss_leaves_no_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Hunt, "judge", lambda *_: [])
    assert not Hunt(1, tmp_path / "found", most=1).hunt().misses
    assert not (tmp_path / "found").exists()


def test_a_hunt_tells_of_a_miss_as_soon_as_it_is_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def judge(hunt: Hunt, index: int, budget: object) -> list[Any]:
        if index == 1:
            raise OutOfTime("interrupted")
        hunt.tally.misses.append(Miss("ledger", index, "off by 1 J", tmp_path / "small.toml", 1))
        return []

    monkeypatch.setattr(Hunt, "judge", judge)
    made = carom("hunt", "--seed", "7", cwd=tmp_path)
    assert f"ledger: scene 0 of seed 7: off by 1 J: {tmp_path}/small.toml, 1 body" in made.stderr.splitlines()


def test_a_budget_that_is_no_time_is_refused_with_what_would_be_right(tmp_path: Path) -> None:
    made = carom("hunt", "--budget", "soon", cwd=tmp_path)
    assert made.returncode == 2 and "such as 60s, 10min or 2h" in made.stderr
