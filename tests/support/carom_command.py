"""The command: in this process, which has the kernels loaded already, or in one of its own."""

from __future__ import annotations

import contextlib
import io
import resource
import subprocess
import sys
from pathlib import Path
from unittest.mock import patch

from carom.cli.main import run_command


def carom(*arguments: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    """Run the command in a folder, in this process: a start of its own costs 1 to 3 s.

    An exception that the command would show as a traceback is raised. What belongs to a process (signals, workers,
    standard streams) needs `carom_process`.
    """
    stdout, stderr = io.StringIO(), io.StringIO()
    code: str | int | None = 0
    with (
        contextlib.chdir(cwd),
        contextlib.redirect_stdout(stdout),
        contextlib.redirect_stderr(stderr),
        patch.object(sys, "argv", ["carom", *arguments]),
        patch("carom.cli.compiling.announce_compilation"),  # the listener would outlive the command
    ):
        try:
            run_command()
        except SystemExit as ended:
            code = ended.code
    assert code is None or isinstance(code, int)
    return subprocess.CompletedProcess(arguments, code or 0, stdout.getvalue(), stderr.getvalue())


def carom_process(*arguments: str, cwd: Path, limit: int | None = None) -> subprocess.CompletedProcess[str]:
    """Run the command in a folder, as a person does; ``limit`` is the size in bytes that a file may have."""

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
