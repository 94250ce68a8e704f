"""Damages a recording in one way after the other, and does to each what the commands do: run as a program.

    python damage_bytes.py RECORDING FOLDER SEED COUNT

Says which file it is at, so that one that ends the process is known; ends with the peak of its memory in MB.
"""

from __future__ import annotations

import resource
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
from rerun.chunk import RrdReader

from carom.errors import PhysicsError, RecordingError, SceneError
from carom.lab.diff.diff import diff
from carom.recording.edit.clip import clip
from carom.recording.edit.repair import repair
from carom.recording.read.recording import Recording

SLOWEST = 20  # s of CPU for one file; all of them take less than 1 s


def flipped(content: bytearray, random: np.random.Generator) -> bytearray:
    """Change single bytes anywhere."""
    for at in random.integers(len(content), size=random.choice([1, 1, 4, 50])):
        content[at] = random.integers(256)
    return content


def truncated(content: bytearray, random: np.random.Generator) -> bytearray:
    """Cut off the end."""
    return content[: random.integers(len(content))]


def swapped(content: bytearray, random: np.random.Generator) -> bytearray:
    """Exchange two blocks."""
    size = int(random.integers(1, 20_000))
    one, other = (int(at) for at in random.integers(len(content) - size, size=2))
    content[one : one + size], content[other : other + size] = (
        content[other : other + size],
        content[one : one + size],
    )
    return content


def edited(content: bytearray, random: np.random.Generator) -> bytearray:
    """Change bytes in the first chunks, in the footer and in the headers of messages."""
    size = len(content)
    heads: list[int] = [at for at in range(size - 16) if content[at] == 2 and content[at + 1 : at + 8] == bytes(7)]
    head = heads[random.integers(len(heads))]
    places = [(0, 300), (0, 30_000), (size - 60, size), (size - 100_000, size), (head, min(head + 400, size))]
    low, high = places[random.integers(len(places))]
    for at in random.integers(low, high, size=random.choice([1, 3, 10])):
        content[at] = (0, 1, 0x7F, 0x80, 0xFF, random.integers(256))[random.integers(6)]
    return content


def removed(content: bytearray, random: np.random.Generator) -> bytearray:
    """Take out a block."""
    at = int(random.integers(len(content)))
    del content[at : at + int(random.integers(1, 50_000))]
    return content


DAMAGES: list[Callable[[bytearray, np.random.Generator], bytearray]] = [flipped, truncated, swapped, edited, removed]


def read_all(path: Path) -> None:
    """Ask a recording for everything."""
    recording = Recording.open(path)
    for question in (
        recording.summary,
        recording.moment,
        recording.events,
        recording.phases,
        recording.layout,
        lambda: recording.bodies,
        lambda: recording.scene_toml,
        lambda: list(recording.checkpoints()),
        recording.impacts,
        recording.contacts,
    ):
        attempt(question)


def attempt(operation: Callable[[], object]) -> None:
    """Run a command on a file; a refusal is correct."""
    try:
        operation()
    except (RecordingError, SceneError, PhysicsError) as error:
        assert "\n" not in str(error), error


def mended(path: Path, out: Path) -> None:
    """Repair a file; what comes out must be fit for Rerun's own reader."""
    if repair(path, out).path is not None:
        read_all(out)
        RrdReader(out).store().stream().to_chunks()


def tell(*what: object) -> None:
    """Print at once, since the next file may end the process."""
    print(*what, flush=True)  # noqa: T201


def peak() -> int:
    """Return the most memory that this process had, in MB; where there is no /proc, or its parent when it began."""
    status = Path("/proc/self/status")
    if status.exists():
        return int(status.read_text(encoding="utf-8").partition("VmHWM:")[2].split()[0]) // 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024


def main(source: Path, folder: Path, seed: int, count: int) -> None:
    """Go through so many damages."""
    whole = source.read_bytes()
    path, out = folder / "damaged.rrd", folder / "out.rrd"
    for k in range(count):
        random = np.random.default_rng([seed, k])
        damage = DAMAGES[k % len(DAMAGES)]
        path.write_bytes(damage(bytearray(whole), random))
        used = resource.getrusage(resource.RUSAGE_SELF)
        tell(k, damage.__name__, peak())
        spent = int(used.ru_utime + used.ru_stime)
        resource.setrlimit(resource.RLIMIT_CPU, (spent + SLOWEST, resource.RLIM_INFINITY))
        attempt(lambda: read_all(path))
        attempt(lambda: clip(path, out, 1.0, 3.0))
        attempt(lambda: clip(path, out, 1.0, 3.0, bodies=[3, 17]))
        attempt(lambda: mended(path, out))
        attempt(lambda: diff(Recording.open(source), Recording.open(path)))
    tell("end", peak())


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]), int(sys.argv[3]), int(sys.argv[4]))
