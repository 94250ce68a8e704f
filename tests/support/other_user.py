"""What another user of the machine can do. CI runs as root, which can become one."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

NOBODY = 65534

as_root = pytest.mark.skipif(os.geteuid() != 0, reason="only root can become another user")


def run_as_nobody(code: str) -> str:
    """Run Python code, with `os` and `socket` imported, as a user without rights; return what it prints.

    It cannot import anything else where Python itself lies in a folder of root.
    """
    change = f"import os, socket, encodings.idna; os.setgroups([]); os.setgid({NOBODY}); os.setuid({NOBODY})\n"
    ran = subprocess.run(
        [sys.executable, "-I", "-S", "-c", change + code], capture_output=True, text=True, check=False, timeout=60
    )
    assert ran.returncode == 0, ran.stderr
    return ran.stdout.strip()
