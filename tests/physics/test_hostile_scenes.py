"""No scene, however absurd, ends in a traceback, a hang, without memory, or with bodies where none can be."""

from __future__ import annotations

import json
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any

import pytest

import hostile_scenes
from carom.errors import PhysicsError
from carom.physics.space import Space
from carom.scene.load import Scene

HANG = 600.0  # s; a scene that computes for a minute ends its process, so this is one that waits for ever


def judged(seed: int, count: int) -> list[dict[str, Any]]:
    """Judge scenes in processes that are ended when one scene takes too long, and begun again with the next."""
    answers: list[dict[str, Any]] = []
    while len(answers) < count:
        command = [sys.executable, hostile_scenes.__file__, *map(str, (seed, len(answers), count - len(answers)))]
        with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as judge:
            assert judge.stdout is not None
            begun = -1
            ended = threading.Timer(HANG, judge.kill)
            ended.start()
            for line in judge.stdout:
                answer = json.loads(line)
                if "begun" in answer:
                    begun = answer["begun"]
                    ended.cancel()
                    ended = threading.Timer(HANG, judge.kill)
                    ended.start()
                else:
                    answers.append(answer)
            ended.cancel()
            if len(answers) == begun:
                answers.append({"index": begun, "ended": "killed", "faults": ["a hang, or the end of its process"]})
            assert begun >= 0, judge.stderr.read() if judge.stderr else ""
    return answers


def explained(seed: int, answer: dict[str, Any]) -> str:
    """Tell what is wrong with a scene, how to judge it again, and what it is."""
    again = f"python tests/support/{Path(hostile_scenes.__file__).name} {seed} {answer['index']} 1"
    return f"{answer}\n{again}\n{json.dumps(hostile_scenes.drawn(seed, answer['index']))}"


@pytest.mark.nightly
@pytest.mark.slow
def test_hostile_scenes_run_or_are_refused_with_a_reason(seed: int) -> None:
    answers = judged(seed, 30)  # `make hunt` judges more
    wrong = [answer for answer in answers if answer["faults"]]
    assert not wrong, f"seed {seed}:\n" + "\n".join(explained(seed, answer) for answer in wrong)
    assert {"ran", "SceneError"} <= {answer["ended"] for answer in answers}, f"seed {seed}"


def test_a_body_that_crosses_its_periodic_box_too_often_in_a_step_is_reported() -> None:
    document = {
        "body": [{"velocity": [1e9, 0.0, 0.0]}, {"position": [0.0, 5.0, 0.0]}],
        "gravity": {"constant": 0.0},
        "domain": {"boundary": "periodic", "size": [20.0, 20.0, 20.0]},
        "time": {"fixed_dt": 0.1},
    }
    with pytest.raises(PhysicsError, match=r"cross its periodic box 5e\+06 times .* lower time.fixed_dt"):
        for _ in Space(Scene.from_dict(document), threads=1).run():
            pass
