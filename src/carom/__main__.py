"""`python -m carom` is the command `carom`."""

from __future__ import annotations

import os
import signal
import sys
from types import FrameType

LEAST_ADDRESS_SPACE = 1.2e9  # bytes; a run of two spheres aborts in Arrow with 0.9 GB, and completes with 1.1 GB
DESCRIPTORS = 40  # required free descriptors: on two cores, every command works with 24, and Rerun aborts below 16
USUAL_DESCRIPTORS = 1024  # usual limit; carom raises a lower limit if the user may do so
RESERVED = "64M"  # size of the blocks of addresses that the allocator of Rerun or Arrow reserves


def main() -> None:
    """Run the command. While carom imports its modules, a signal ends it with one line: nothing is open yet."""
    if os.name != "posix":
        sys.exit("carom: runs on Linux, macOS and other POSIX systems only; on Windows, use WSL")
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        if signal.getsignal(number) in (signal.SIG_DFL, signal.default_int_handler):  # nohup ignores SIGHUP
            signal.signal(number, end_at_once)
    fit_into_address_space()
    fit_into_descriptors()
    # the system's allocator is used, since Arrow's own keeps freed memory: a clip took 30 MB more, in the same time
    os.environ.setdefault("ARROW_DEFAULT_MEMORY_POOL", "system")
    # otherwise Pydantic would load plugins of any package, and fail if the metadata of one package are damaged
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")
    from carom.cli.main import main as run  # noqa: PLC0415 - takes half a second
    from carom.runs.environment import raise_signals  # noqa: PLC0415 - checks come first

    raise_signals([end_at_once])
    run()


def end_at_once(number: int, frame: FrameType | None) -> None:
    """End the process as its signal demands, since any code could catch an exception within an import."""
    os.write(2, b"carom: interrupted\n")
    os._exit(128 + number)


def fit_into_address_space() -> None:
    """Exit if ``ulimit -v`` leaves too little for the libraries; under any limit, let the libraries reserve little.

    Rerun and Arrow each reserve a GiB of addresses if possible. Under a limit of 2 GB, OpenBLAS or Arrow then aborted
    for lack of a few kB. Both read the size of the reservation when they are loaded.
    """
    import resource  # noqa: PLC0415 - POSIX only

    limit, _ = resource.getrlimit(resource.RLIMIT_AS)
    if limit == resource.RLIM_INFINITY:
        return
    os.environ.setdefault("MIMALLOC_ARENA_RESERVE", RESERVED)
    if limit < LEAST_ADDRESS_SPACE:
        sys.stderr.write(
            f"carom: address space is limited to {limit / 1e9:.3g} GB, and its libraries need "
            f"{LEAST_ADDRESS_SPACE / 1e9:.2g} GB or more; raise the limit (ulimit -v, in kB)\n"
        )
        sys.exit(2)


def fit_into_descriptors() -> None:
    """Raise a low limit of open files as far as permitted; exit if fewer than `DESCRIPTORS` more can be opened."""
    import resource  # noqa: PLC0415 - POSIX only

    limit, most = resource.getrlimit(resource.RLIMIT_NOFILE)
    free = list[int]()
    try:
        if resource.RLIM_INFINITY != limit < USUAL_DESCRIPTORS:
            reachable = USUAL_DESCRIPTORS if most == resource.RLIM_INFINITY else min(USUAL_DESCRIPTORS, most)
            resource.setrlimit(resource.RLIMIT_NOFILE, (reachable, most))
        while len(free) < DESCRIPTORS:
            free.append(os.open(os.devnull, os.O_RDONLY))
    except OSError:
        sys.stderr.write(
            f"carom: only {len(free)} more files can be opened, and its libraries need {DESCRIPTORS}; raise the limit "
            f"(ulimit -n, now {limit})\n"
        )
        sys.exit(2)
    finally:
        for descriptor in free:
            os.close(descriptor)


if __name__ == "__main__":
    main()
