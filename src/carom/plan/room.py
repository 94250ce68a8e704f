"""The memory and the disk space that a run needs, and that this process may use."""

from __future__ import annotations

import os
import shutil
import sys
from collections.abc import Iterator
from pathlib import Path

from carom.errors import RecordingError, SceneError
from carom.plan.auto import frame_interval, gravity_method, integrator, step_limits
from carom.scene.load import Scene

BYTES_PER_BODY = 700  # bytes for state, workspace and initial state; measured at 10⁵ bodies and rounded up
# bytes for waiting and encoded frames; measured in runs of 2 × 10⁵ bodies that record every step
RECORDED_BYTES_PER_BODY = 2000
TRIALS = 1.4  # memory of an estimate over a run's memory, since it holds several runs at once; measured on one scene
ADDRESSES_OF_LIBRARIES = 1_100_000_000  # bytes that a run of two bodies maps, mostly libraries
ADDRESSES_PER_BODY = 4000  # bytes mapped by a run that records every step; with 2400, a run of 4 × 10⁵ bodies aborts
# "direct" has 16 slabs of sums, "tree" has boxes
GRAVITY_BYTES_PER_BODY = {"none": 0, "direct": 550, "tree": 130, "fast-multipole": 280}

LEAST_PER_BODY = 5  # bytes of a frame in the file: positions on a lattice at rest take 5.6
# Bodies in a frame of 64 kB, the window of LZ4. Smaller frames may repeat earlier frames within the window, and then
# take almost no space.
LEAST_BODIES = (1 << 16) // 12

_UNKNOWN = 2**47  # bytes of the whole address space, which mean "no limit known"
_OWN_MEMORY = Path("/proc/self/statm")  # on Linux; the second number counts pages in memory
_CGROUPS = Path("/sys/fs/cgroup")


def memory_estimate(scene: Scene) -> int:
    """Estimate the memory of a run in bytes, without its contacts."""
    return scene.count * (BYTES_PER_BODY + GRAVITY_BYTES_PER_BODY[gravity_method(scene)])


def refuse_small_memory(scene: Scene, runs: float = 1.0) -> None:
    """Refuse a scene that exceeds the memory, or the limit of ``ulimit -v``, at which Rerun and OpenBLAS abort.

    All code that places bodies calls this function first; ``runs`` is the number of runs that it holds at once. Raises
    SceneError.
    """
    import resource  # noqa: PLC0415 - POSIX only

    needed = memory_estimate(scene) + RECORDED_BYTES_PER_BODY * scene.count
    counts = [group.count for group in scene.group]
    memory, owner = usable_memory()
    if runs * needed > memory:
        what, size = ("need", needed) if needed > memory else ("can run, but a trial run needs", runs * needed)
        raise SceneError(
            f"{scene.count:.3g} bodies {what} about {size / 1e9:.3g} GB of memory, but {owner} {memory / 1e9:.3g} GB; "
            "lower the count",
            ("group", counts.index(max(counts)), "count") if counts else (),
        )
    limit, _ = resource.getrlimit(resource.RLIMIT_AS)
    needed = ADDRESSES_OF_LIBRARIES + ADDRESSES_PER_BODY * scene.count
    if limit != resource.RLIM_INFINITY and limit < needed:
        raise SceneError(
            f"{scene.count:.3g} bodies need about {needed / 1e9:.3g} GB of address space, but `ulimit -v` allows "
            f"{limit / 1e9:.3g} GB; raise the limit or lower the count"
        )


def resident_memory() -> int:
    """Return the memory (bytes) of this process now, or its peak so far if the present value is unknown."""
    import resource  # noqa: PLC0415 - POSIX only

    try:
        pages = int(_OWN_MEMORY.read_text(encoding="ascii").split()[1])
        return pages * os.sysconf("SC_PAGE_SIZE")
    except (OSError, ValueError, IndexError):
        largest = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        return largest if sys.platform == "darwin" else 1024 * largest  # macOS counts bytes, others kB


def usable_memory() -> tuple[int, str]:
    """Return the memory that this process may use, in bytes, and who sets the limit, as in "this machine has"."""
    import resource  # noqa: PLC0415 - POSIX only

    try:
        found = [(os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"), "this machine has")]
    except (AttributeError, ValueError, OSError):
        found = [(_UNKNOWN, "this machine has")]
    data, _ = resource.getrlimit(resource.RLIMIT_DATA)
    if data != resource.RLIM_INFINITY:
        found.append((data, "`ulimit -d` allows"))
    found += [(limit, "its control group (a container or a scheduler) allows") for limit in _group_limits()]
    return min(found)


def _group_limits(own: Path = Path("/proc/self/cgroup"), root: Path = _CGROUPS) -> Iterator[int]:
    """Yield the memory limits (bytes) of this process's control groups and of the groups around them; Linux only."""
    try:
        groups = own.read_text(encoding="utf-8").splitlines()
    except OSError:
        return
    for group in groups:
        _, kinds, path = (*group.split(":", 2), "", "")[:3]
        if kinds not in ("", "memory"):
            continue
        top, name = (root / "memory", "memory.limit_in_bytes") if kinds else (root, "memory.max")
        inner = Path(path.lstrip("/"))
        for folder in (inner, *inner.parents):  # in a container, perhaps only the outermost folder is visible
            try:
                yield int((top / folder / name).read_text(encoding="ascii"))
            except (OSError, ValueError):  # "max" is not a number
                continue


def refuse_small_disk(scene: Scene, folder: Path, begin: float = 0.0) -> None:
    """Refuse a recording from a time (s) on that is certain not to fit on the disk of a folder. Raises RecordingError.

    Only positions of bodies are counted, at the smallest size that they can have. Nothing is refused if the number of
    steps is not known.
    """
    if scene.count < LEAST_BODIES:
        return
    interval = frame_interval(scene) or scene.time.fixed_dt or _longest_step(scene)
    frames = (scene.time.duration - begin) / interval
    least, free = frames * scene.count * LEAST_PER_BODY, shutil.disk_usage(folder).free
    if least > free:
        raise RecordingError(
            f"the recording of {scene.count} bodies in {frames:.3g} frames takes at least {least / 1e9:.3g} GB, but "
            f"the disk of {folder} has {free / 1e9:.3g} GB free; raise record.every, or shorten time.duration"
        )


def _longest_step(scene: Scene) -> float:
    """Return the longest step (s) of a scene; infinity if its integrator chooses the steps."""
    return float("inf") if integrator(scene).controls_error or scene.time.accuracy else step_limits(scene).max_dt
