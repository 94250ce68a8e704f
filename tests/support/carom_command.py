"""The command: in this process, which has the kernels loaded already, or in one of its own."""

from __future__ import annotations

import contextlib
import io
import json
import os
import resource
import shlex
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from unittest.mock import patch

from carom.cli.main import run_command

# A script that runs several commands: each start of a process of its own loads carom for a second or more.
TOGETHER = """
import json, sys
from pathlib import Path
from carom_command import carom
ended = [carom(*command, cwd=Path()) for command in json.loads(sys.argv[1])]
print(json.dumps([(command.returncode, command.stdout, command.stderr) for command in ended]))
"""


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
        patch("carom.physics.jit.decorators.on_compilation"),  # the listener would outlive the command
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


def with_paths(*folders: Path) -> dict[str, str]:
    """Return an environment in which Python finds modules in these folders, this one, and those of PYTHONPATH."""
    paths = [*map(str, folders), str(Path(__file__).parent), *filter(None, [os.environ.get("PYTHONPATH")])]
    return os.environ | {"PYTHONPATH": os.pathsep.join(paths), "COLUMNS": "200"}


def carom_together(
    *commands: str, cwd: Path, environment: Mapping[str, str], before: str = ""
) -> list[subprocess.CompletedProcess[str]]:
    """Run commands one after the other, in one process with this environment, after some lines of Python."""
    given = json.dumps([shlex.split(command) for command in commands])
    started = [sys.executable, "-c", before + TOGETHER, given]
    done = subprocess.run(started, cwd=cwd, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    ends = json.loads(done.stdout)
    return [subprocess.CompletedProcess(command, *end) for command, end in zip(commands, ends, strict=True)]
