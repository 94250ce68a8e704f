"""A scene that needs more memory or disk than there is, is refused before a body is placed."""

from __future__ import annotations

import json
import os
import resource
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

from carom.errors import RecordingError, SceneError
from carom.physics.placement.initial_state import place
from carom.plan import room
from carom.plan.room import LEAST_BODIES, refuse_small_disk, refuse_small_memory, usable_memory
from carom.runs.estimate import estimate
from carom.scene.load import Scene

GB = 10**9


def crowd(count: int, **sections: Any) -> Scene:
    side = (count * 10.0) ** (1.0 / 3.0)
    group = {"count": count, "radius": 0.5, "region": {"shape": "box", "size": [side] * 3}}
    return Scene.from_dict({"group": [group], "time": {"duration": 1.0, "fixed_dt": 0.1}} | sections)


@pytest.mark.parametrize("use", [place, estimate])
def test_a_thousand_million_bodies_are_refused_at_once_by_whatever_places_them(use: Any) -> None:
    began = time.process_time()
    with pytest.raises(SceneError, match=r"1e\+09 bodies need about .* GB of memory"):
        use(crowd(10**9))
    assert time.process_time() - began < 1.0


@pytest.mark.slow  # a process of its own for each answer
def test_explain_refuses_what_run_refuses_and_takes_no_memory_for_it(tmp_path: Path) -> None:
    (tmp_path / "scene.toml").write_text("[[group]]\ncount = 1000000000\nradius = 0.5\n", encoding="utf-8")
    ends = []
    for command in ("explain", "run", "sweep --vary seed=1,2"):
        done = subprocess.run(
            [sys.executable, "-m", "carom", *command.split(), "scene.toml"],
            cwd=tmp_path,
            capture_output=True,
            text=True,
            check=False,
            preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_DATA, (4 * GB, 4 * GB)),
        )
        ends.append(done.stderr)
        assert done.returncode in (1, 2) and "`ulimit -d` allows 4 GB" in done.stderr + done.stdout
        assert "Traceback" not in done.stderr
    assert ends[0] == ends[1]


def groups(folder: Path, lines: str, **limits: str) -> tuple[Path, Path]:
    for name, text in limits.items():
        file = folder / name.replace("__", "/").replace("_max", ".max").replace("_limit", ".limit")
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text, encoding="ascii")
    (folder / "own").write_text(lines, encoding="ascii")
    return folder / "own", folder


@pytest.mark.parametrize(
    ("lines", "limits", "found"),
    [
        ("0::/a/b\n", {"a__b__memory_max": "max", "a__memory_max": "3000"}, [3000]),
        ("0::/a\n", {"memory_max": "9000", "a__memory_max": "3000"}, [3000, 9000]),
        ("0::/gone\n", {"memory_max": "9000"}, [9000]),
        ("4:memory:/job\n1:cpu:/\n", {"memory__job__memory_limit_in_bytes": "5000"}, [5000]),
        ("4:memory:/job\n0::/\n", {"memory__memory_limit_in_bytes": "5000"}, [5000]),
        ("nonsense\n", {}, []),
    ],
)
def test_limits_of_control_groups_are_those_around_the_process(
    lines: str, limits: dict[str, str], found: list[int], tmp_path: Path
) -> None:
    assert list(room._group_limits(*groups(tmp_path, lines, **limits))) == found


def test_the_smallest_limit_counts(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(room, "_group_limits", lambda: iter([GB, 10**6]))
    assert usable_memory() == (10**6, "its control group (a container or a scheduler) allows")
    with pytest.raises(SceneError, match=r"control group \(a container or a scheduler\) allows 0.001 GB"):
        refuse_small_memory(crowd(10_000))


def test_a_recording_that_cannot_fit_on_the_disk_does_not_begin(tmp_path: Path) -> None:
    many = crowd(20_000, record={"every": "step"})
    refuse_small_disk(many, tmp_path)
    free = os.statvfs(tmp_path)
    steps = 1 + 10 * free.f_bavail * free.f_frsize // (20_000 * room.LEAST_PER_BODY)
    endless = crowd(20_000, record={"every": "step"}, time={"duration": 0.1 * steps, "fixed_dt": 0.1})
    with pytest.raises(RecordingError, match=r"takes at least .* GB, but the disk of .* GB free; raise record\.every"):
        refuse_small_disk(endless, tmp_path)
    refuse_small_disk(endless, tmp_path, begin=0.1 * (steps - 10))
    few = crowd(LEAST_BODIES - 1, record={"every": "step"}, time={"duration": 0.1 * steps, "fixed_dt": 0.1})
    refuse_small_disk(few, tmp_path)  # frames may repeat one another
    assert json.dumps([str(path) for path in tmp_path.iterdir()]) == "[]"


def test_an_estimate_needs_more_than_a_run_and_is_refused_for_its_own_sake(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = crowd(100_000)
    a_run = 100_000 * (room.BYTES_PER_BODY + room.RECORDED_BYTES_PER_BODY)
    monkeypatch.setattr(room, "_group_limits", lambda: iter([round(1.1 * a_run)]))
    refuse_small_memory(scene)
    with pytest.raises(SceneError, match=r"1e\+05 bodies can run, but a trial run needs about .* GB of memory"):
        estimate(scene)
