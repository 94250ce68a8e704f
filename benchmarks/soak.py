"""The memory of a run of hours or days, and its growth with the recorded time and the messages in the file.

    python benchmarks/soak.py                      # 5 minutes that stand for 100
    python benchmarks/soak.py --minutes 30 --faster 40
    python benchmarks/soak.py --apart              # batches are never joined, as in versions before 26 November 2026

A gas of 20 bodies is recorded at 10 frames a second. Everything is faster by a factor, including the batches: a second
of the recorder lasts 1/20 s. Memory is that of the whole process, which also holds the physics and the compiled
kernels.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from contextlib import ExitStack
from pathlib import Path
from typing import Any, NamedTuple
from unittest import mock

import numpy as np

from carom.runs.environment import keep_freed_memory

keep_freed_memory()  # as the carom command does, before NumPy starts its threads

from carom.recording.rrd.container import Container  # noqa: E402
from carom.recording.write import recorder as recorders  # noqa: E402
from carom.recording.write import stream as streams  # noqa: E402
from carom.runs.run import header_of, recording_space  # noqa: E402
from carom.scene.load import Scene  # noqa: E402
from measurement import save  # noqa: E402

FRAMES = 10.0  # a second
SAMPLES = 20
SCENE: dict[str, Any] = {
    "seed": 1,
    "time": {"duration": 1e9, "max_dt": 0.1},
    "gravity": {"constant": 0.0},
    "contact": {"restitution": 1.0, "static_friction": 0.0},
    "domain": {"boundary": "periodic", "size": [20.0, 20.0, 20.0]},
    "record": {"every": 0.1},
    "group": [{"count": 20, "radius": 0.5, "velocity": {"dispersion": 1.0}}],
}


class Sample(NamedTuple):
    """The state of a recording at one moment."""

    hours: float  # of the run that it stands for
    frames: int
    messages: int  # in the file
    file: float  # MB
    memory: float  # MB, resident


def memory() -> float:
    status = Path("/proc/self/status").read_text(encoding="utf-8")
    return int(status.partition("VmRSS:")[2].split()[0]) / 1024


def soak(path: Path, minutes: float, faster: float, apart: bool) -> list[Sample]:
    """Record for some minutes; print and return samples."""
    space = recording_space(Scene.from_dict(SCENE), 1)
    found = list[Sample]()
    with ExitStack() as stack:
        stack.enter_context(mock.patch.object(recorders, "_BATCH_SECONDS", recorders._BATCH_SECONDS / faster))
        stack.enter_context(mock.patch.object(streams, "monotonic", lambda: faster * time.monotonic()))
        if apart:
            stack.enter_context(mock.patch.object(streams, "PROMPT_BATCHES", 10**9))
        recorder = stack.enter_context(recorders.FrameRecorder(path, header_of(space)))
        began, length = time.monotonic(), 60.0 * minutes
        for frame in space.run(store=recorder.store_for(space.state)):
            recorder.put(frame)
            spent = time.monotonic() - began
            if spent >= length * (len(found) + 1) / SAMPLES:
                sink = recorder._stream._sink
                found.append(
                    Sample(spent * faster / 3600, recorder.frames, sink.messages, sink.written / 1e6, memory())
                )
                print(
                    "{:7.2f} h {:9d} frames {:9d} messages {:9.1f} MB in the file {:7.1f} MB of memory".format(
                        *found[-1]
                    )
                )
            if spent >= length:
                break
            time.sleep(max(0.0, recorder.frames / (FRAMES * faster) - spent - 0.5))  # it may lag behind, and catch up
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=5.0)
    parser.add_argument("--faster", type=float, default=20.0, help="than a run whose batches last a second")
    parser.add_argument("--apart", action="store_true", help="never join batches")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "soak.rrd"
        found = soak(path, options.minutes, options.faster, options.apart)
        store = Container.open(path).stores[0]
        print(f"{len(store.entries)} messages in the closed file of {path.stat().st_size / 1e6:.1f} MB")
    late = np.array(found[len(found) // 2 :])  # by then kernels, queue and buffers have their sizes
    each_hour, each_message = (np.polyfit(late[:, k], late[:, -1], 1)[0] for k in (0, 2))
    print(f"in the second half {each_hour:+.1f} MB an hour, {1e3 * each_message:+.2f} kB a message")
    if not options.apart:
        save("soak", {"faster": options.faster, "samples": [sample._asdict() for sample in found]})


if __name__ == "__main__":
    main()
