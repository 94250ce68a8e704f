"""A second process compiles kernels beside the first run on a machine."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from carom.physics import jit as parallel
from carom.physics.jit import cores
from carom.physics.space import Space
from carom.runs.warmup import SCENES
from carom.scene.load import Scene
from carom.terminal import compilation
from other_processor import OtherProcessor, written

PILE = {"title": "a pile", **SCENES["a pile, recorded"]}
STEPS = 5
RUN = f"""
import json
from numba.core import event
from carom.physics.space import Space
from carom.scene.load import Scene

class Listener(event.Listener):
    def __init__(self):
        self.compiled = []
    def on_start(self, found):
        self.compiled.append(found.data["dispatcher"].py_func.__name__)
    def on_end(self, found):
        pass

listener = Listener()
event.register("numba:compile", listener)
space = Space(Scene.from_dict({PILE!r}))
for step in range({STEPS}):
    space.compute_dynamics(step + 1)
print(json.dumps([space.fingerprint(), listener.compiled]))
"""
START = """
import sys
from carom.terminal.compilation import start_compiling
print(start_compiling().pid, flush=True)
sys.stdin.read()
"""


def is_running(pid: int) -> bool:
    """Tell whether a process runs; one that has ended and that nobody has asked about does not."""
    state = subprocess.run(["ps", "-o", "stat=", "-p", str(pid)], capture_output=True, text=True, check=False).stdout
    return bool(state.strip()) and not state.startswith("Z")


@pytest.mark.parametrize("end", [signal.SIGTERM, signal.SIGKILL])
@pytest.mark.skipif(cores() < 2, reason="on one core there is no second process")
def test_the_second_process_ends_with_the_first_however_that_ends(tmp_path: Path, end: signal.Signals) -> None:
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)}
    starting = [sys.executable, "-c", START]
    with subprocess.Popen(starting, stdin=subprocess.PIPE, stdout=subprocess.PIPE, env=environment) as first:
        assert first.stdout is not None
        second = int(first.stdout.readline())
        assert is_running(second)
        first.send_signal(end)
        first.wait()
    deadline = time.monotonic() + 60.0  # it takes a second or two to load
    while is_running(second) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not is_running(second)


def test_no_second_process_is_started_where_it_could_not_help(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(compilation, "cores", lambda: 1)
    assert compilation.start_compiling() is None


def test_on_a_new_installation_the_second_process_starts_at_once(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    kernels = tmp_path / "__pycache__"
    kernels.mkdir()
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    started: list[str] = []
    monkeypatch.setattr(parallel, "__file__", str(tmp_path / "__init__.py"))
    monkeypatch.setattr(compilation, "start_compiling", lambda: started.append("a process"))
    compilation.start_on_a_new_installation()
    (kernels / "a-kernel.nbc").touch()
    compilation.start_on_a_new_installation()
    assert len(started) == 1


@pytest.mark.nightly
@pytest.mark.slow
def test_a_run_uses_what_another_process_compiled_and_ends_with_the_same_bits(other_processor: OtherProcessor) -> None:
    taken = {Path(file).name.split("-")[0].rpartition(".")[2] for file in other_processor.ahead}
    run = subprocess.run(
        [sys.executable, "-c", RUN], env=other_processor.environment, stdout=subprocess.PIPE, check=True
    )
    fingerprint, compiled = json.loads(run.stdout)
    phases = {
        "project",
        "conjugate_step",
        "conjugate_direction",
        "measure_violation",
        "audit",
        "solve_turning",
        "warm_start",
    }
    assert phases | {"search", "_sum_blocks", "rotate_rows", "_join", "write_contacts", "draw_edges"} <= taken
    assert not phases & set(compiled)
    assert other_processor.ahead.items() <= written(other_processor.kernels).items()  # nobody compiled them again
    space = Space(Scene.from_dict(PILE))
    for step in range(STEPS):
        space.compute_dynamics(step + 1)
    assert space.fingerprint() == fingerprint
