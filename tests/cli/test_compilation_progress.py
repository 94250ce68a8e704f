"""What is said while kernels are compiled."""

from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path

import pytest

from carom.scene.load import Scene
from carom.terminal import compilation_progress
from carom.terminal.compilation_progress import POINTS, CompilationProgress, kernels_needed
from carom.terminal.console import LINE_EVERY, LiveLine


def test_the_time_left_follows_from_the_kernels_so_far_and_a_pipe_gets_a_line_now_and_then(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    ready, clock, said = 1, 100.0, list[str]()
    monkeypatch.setattr(LiveLine, "interlude", LiveLine.interlude)  # put back afterwards
    monkeypatch.setattr(compilation_progress, "kernels_ready", lambda: ready)
    monkeypatch.setattr(time, "perf_counter", lambda: clock)
    progress = CompilationProgress(Scene.load("figure-eight"), said.append)
    assert LiveLine.interlude(clock) == "", "no kernel is being compiled"
    progress.on_start(None)
    assert said == [], "the first line is that of the announcement"
    ready, clock = 2, clock + LINE_EVERY
    progress.on_start(None)
    assert said == [f"Compiling: 2 of about {POINTS} kernels"], "a single kernel tells no rate"
    ready, clock = 11, clock + LINE_EVERY  # ten kernels in ten seconds
    progress.on_start(None)
    assert said[1:] == [f"Compiling: 11 of about {POINTS} kernels, about {POINTS - 11} s left"]
    assert LiveLine.interlude(clock).endswith(said[-1]) and "━" in LiveLine.interlude(clock)
    for _ in range(3):
        progress.on_end(None)
    assert LiveLine.interlude(clock) == ""
    ready = POINTS + 3
    assert progress.counts() == f"{ready} of about {ready}", "never more than there are"


RUN = """
import sys
from carom import run
from carom.terminal.compilation_progress import kernels_ready
run(sys.argv[1], sys.argv[2])
print(kernels_ready())
"""
NEAR = 0.1  # of the kernels that are needed: a bar that ends at 90 or 110 % misleads nobody


@pytest.mark.slow
@pytest.mark.parametrize("name", ["figure-eight", "two-spheres"])
def test_a_run_ends_with_about_as_many_kernels_as_were_expected(name: str, tmp_path: Path) -> None:
    command = [sys.executable, "-c", RUN, name, str(tmp_path / "run.rrd")]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert int(done.stdout) == pytest.approx(kernels_needed(Scene.load(name)), rel=NEAR)
