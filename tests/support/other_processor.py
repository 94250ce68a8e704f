"""Kernels for a processor without AVX, in a folder of their own, which all tests that need such kernels share."""

from __future__ import annotations

import fcntl
import json
import os
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import pytest


@dataclass(frozen=True)
class OtherProcessor:
    """How a process computes with these kernels, and which of them `carom.runs.warmup` has compiled."""

    kernels: Path
    environment: dict[str, str]
    ahead: dict[str, int]  # file → when it was written (ns)


def environment_of(kernels: Path) -> dict[str, str]:
    """Return the environment of a process that computes with these kernels."""
    generic = {"NUMBA_CPU_NAME": "generic", "NUMBA_CPU_FEATURES": ""}
    return os.environ | generic | {"NUMBA_CACHE_DIR": str(kernels)}


def written(kernels: Path) -> dict[str, int]:
    """Return the files of compiled kernels, and when they were written."""
    return {str(path): path.stat().st_mtime_ns for path in kernels.rglob("*.nbc")}


@pytest.fixture(scope="session")
def other_processor(tmp_path_factory: pytest.TempPathFactory) -> OtherProcessor:
    """Compile ahead; processes of a test run share the result, and the first one makes it."""
    folder = tmp_path_factory.getbasetemp()
    folder = folder.parent if "PYTEST_XDIST_WORKER" in os.environ else folder
    kernels, answers = folder / "other-processor", folder / "other-processor.json"
    environment = environment_of(kernels)
    with (folder / "other-processor.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not answers.exists():
            kernels.mkdir(mode=0o700)
            ahead = [sys.executable, "-m", "carom.runs.warmup"]
            with subprocess.Popen(ahead, stdin=subprocess.PIPE, env=environment) as second:
                assert second.wait() == 0
            answers.write_text(json.dumps(written(kernels)), encoding="utf-8")
    return OtherProcessor(kernels, environment, json.loads(answers.read_text(encoding="utf-8")))
