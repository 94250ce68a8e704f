"""`python -m carom` is the command `carom`."""

from __future__ import annotations

import os
import sys


def main() -> None:
    """Run the command; an interrupt while it is loaded ends it without a traceback."""
    if os.name != "posix":
        sys.exit("carom: runs on Linux, macOS and other POSIX systems only; on Windows use WSL")
    try:
        from carom.cli.process import main as run  # noqa: PLC0415 - takes half a second
    except KeyboardInterrupt:
        os.write(2, b"carom: interrupted\n")
        os._exit(130)
    run()


if __name__ == "__main__":
    main()
