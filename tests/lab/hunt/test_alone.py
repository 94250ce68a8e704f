"""A scene has the same bits alone in a new process as after other scenes in one process."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from carom.lab.hunt import alone
from carom.lab.hunt.alone import Ending, difference, in_new_processes, last_ending
from carom.lab.hunt.random_scenes import drawn
from carom.lab.shrink.trials import Budget
from carom.runs.environment import Interrupts
from carom_command import carom

SEED = 1756  # its first scenes are a rotating sphere, a cylinder at rest and planes: layouts that one process mixes


@pytest.mark.slow
def test_walls_that_move_and_walls_at_rest_in_one_process_leave_the_bits_of_each_other(tmp_path: Path) -> None:
    walls = [wall for index in range(3) for wall in drawn(SEED, index).document["wall"]]
    assert {"rotation" in wall.get("motion", {}) for wall in walls} == {True, False}
    made = carom("hunt", "--seed", str(SEED), "--scenes", "3", "--alone", "-o", "found", cwd=tmp_path)
    assert made.returncode == 0, made.stdout


@pytest.fixture
def budget() -> Iterator[Budget]:
    with Interrupts() as interrupts:
        yield Budget(math.inf, interrupts)


def test_a_scene_that_another_one_changes_is_reported_with_it(budget: Budget, monkeypatch: pytest.MonkeyPatch) -> None:
    ended: dict[tuple[Any, ...], Ending] = {((1, 9),): Ending(5, 10)} | {
        ((1, k), (1, 9)): Ending(5, 10) for k in (2, 7)
    }
    ended[((1, 4), (1, 9))] = Ending(5, 11)  # scene 4 leaks into scene 9
    monkeypatch.setattr(alone, "in_new_processes", lambda tasks, budget: (ended[tuple(task)] for task in tasks))
    assert difference(1, 9, Ending(5, 10), [2, 4, 7], budget) == ""
    assert "scene 4" in difference(1, 9, Ending(5, 11), [2, 4, 7], budget)
    assert "not after any single other scene" in difference(1, 9, Ending(5, 12), [2, 7], budget)


@pytest.mark.slow
def test_a_new_process_runs_scenes_in_order_and_returns_the_last_end(budget: Budget) -> None:
    scenes = [(SEED, 0), (SEED, 0)]
    assert list(in_new_processes([scenes], budget)) == [last_ending(scenes[:1])]
