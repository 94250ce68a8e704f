"""`python -m carom` is the command `carom`."""

from __future__ import annotations

import os
import sys

LEAST_ADDRESS_SPACE = 1.2e9  # bytes; with 0.9 GB Arrow aborts in the middle of a run of two spheres, with 1.1 it ends
RESERVED = "64M"  # addresses that an allocator of Rerun or Arrow reserves at a time


def main() -> None:
    """Run the command; an interrupt while it is loaded ends it without a traceback."""
    if os.name != "posix":
        sys.exit("carom: runs on Linux, macOS and other POSIX systems only; on Windows use WSL")
    fit_into_address_space()
    # Arrow's own allocator keeps what is freed: a clip took 30 MB more with it, in the same time
    os.environ.setdefault("ARROW_DEFAULT_MEMORY_POOL", "system")
    try:
        from carom.cli.process import main as run  # noqa: PLC0415 - takes half a second
    except KeyboardInterrupt:
        os.write(2, b"carom: interrupted\n")
        os._exit(130)
    run()


def fit_into_address_space() -> None:
    """Exit where ``ulimit -v`` leaves too little for the libraries; where it is set, let them reserve little.

    Rerun and Arrow each reserve a GiB of addresses if they can. Under a limit of 2 GB they could, and OpenBLAS or Arrow
    then aborted for want of a few kB. Both read the size of the reservation when they are loaded.
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


if __name__ == "__main__":
    main()
