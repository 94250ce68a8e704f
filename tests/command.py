"""The command, run as a person runs it."""

from __future__ import annotations

import resource
import subprocess
import sys
from pathlib import Path


def carom(*arguments: str, cwd: Path, limit: int | None = None) -> subprocess.CompletedProcess[str]:
    """Run the command in a folder; ``limit`` is the size in bytes that a file may have."""

    def small_disk() -> None:
        assert limit is not None
        resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))

    return subprocess.run(
        [sys.executable, "-m", "carom", *arguments],
        cwd=cwd,
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
        preexec_fn=small_disk if limit else None,
    )
