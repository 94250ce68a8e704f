"""The cost of recording every step: runs with a recording compared with the same runs without one.

    python benchmarks/recording.py            # all scenes, 7 rounds
    python benchmarks/recording.py --rounds 15 marbles-in-a-box
    python benchmarks/recording.py --default  # the default recordings of bundled scenes, 7 rounds
    python benchmarks/recording.py --commands # the same of `carom run`, which starts Python and Rerun
    python benchmarks/recording.py --writing  # the cost of frames beside Rerun, which writes the same data
    python benchmarks/recording.py --details  # what exact states take, and memory

Rounds are interleaved and medians compared. "Only steps" makes no frames. "Frames for nobody" makes every frame, with
its energy, momentum and fingerprint, but does not record it. CPU time is that of the physics thread, of the recorder's
Python and of all other threads; it shows where the time goes even on a busy machine, where wall time is misleading.
"""

from __future__ import annotations

import argparse
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any
from unittest import mock

from carom.runs.environment import keep_freed_memory

keep_freed_memory()  # as the carom command does, before NumPy starts its threads

import numpy as np  # noqa: E402
import rerun as rr  # noqa: E402

from carom.physics.schedule import at  # noqa: E402
from carom.physics.space import Space  # noqa: E402
from carom.recording.rrd.container import Container  # noqa: E402
from carom.recording.schema.header import Header  # noqa: E402
from carom.recording.write.recorder import FrameRecorder  # noqa: E402
from carom.recording.write.rerun_compat import rerun_chunks  # noqa: E402
from carom.runs import run as experiment  # noqa: E402
from carom.runs.run import Outcome, header_of, recording_space, simulate  # noqa: E402
from carom.scene.load import Scene  # noqa: E402
from carom.scene.scene_file import bundled_scenes  # noqa: E402
from carom.state.frame import Frame  # noqa: E402
from measurement import merge  # noqa: E402

ROUNDS = 7
DURATION = 20_000.0  # s simulated, some 1800 steps: opening and closing a file takes 0.1 s whatever its length
THOUSAND = ["group.0.count=1000", "group.0.region.radius=38", f"time.duration={DURATION}"]
SCENES: dict[str, tuple[str, list[str]]] = {
    "cloud-collapse": ("cloud-collapse", []),
    "marbles-in-a-box": ("marbles-in-a-box", []),
    "1000-bodies": ("cloud-collapse", THOUSAND),
}
PEER_TIMES = 5  # since Rerun takes 15 ms, too little to measure
WRITTEN = ("newtons-cradle", "heap")  # frames of few bodies, and frames with contacts
ONLY_STEPS = """
import sys
from carom import Scene, Space
from carom.physics.schedule import at
for _ in Space(Scene.load(sys.argv[1])).run(schedule=at(())):
    pass
"""
VARIANTS = ("only steps", "frames for nobody", 'impacts = "none"', 'impacts = "auto"')


@dataclass(frozen=True)
class Taken:
    """The times of one run, in s."""

    wall: float
    physics: float  # CPU of the thread that steps
    recorder: float  # CPU of the thread that encodes; it mostly holds the interpreter's lock
    others: float  # CPU of all other threads: helpers of the physics, Rerun's, the file's


def scene(name: str, impacts: str) -> Scene:
    bundled, changes = SCENES[name]
    return Scene.load(bundled, [*changes, "record.every=step", f"record.impacts={impacts}"])


@contextmanager
def timed_threads() -> Iterator[dict[str, float]]:
    """Measure the CPU times of the physics thread and of the recorder's thread."""
    spent = {"physics": 0.0, "recorder": 0.0}

    def timed(part: str, function: Callable[..., Any]) -> Callable[..., Any]:
        def call(*arguments: Any) -> None:
            began = time.thread_time()
            function(*arguments)
            spent[part] += time.thread_time() - began

        return call

    stepping, recording = experiment._Physics, FrameRecorder
    physics: Any = mock.patch.object(stepping, "_run", timed("physics", stepping._run))
    recorder: Any = mock.patch.object(recording, "_record", timed("recorder", recording._record))
    with physics, recorder:
        yield spent


def measure(name: str, variant: str, path: Path) -> tuple[Taken, int]:
    """Run a scene in one variant; return its times and its number of steps."""
    space = recording_space(scene(name, "none" if "auto" not in variant else "auto"))
    with timed_threads() as spent:
        began, cpu, own = time.perf_counter(), _cpu(), time.thread_time()
        if variant == "only steps":
            only_steps(space)
        elif variant == "frames for nobody":
            frames_for_nobody(space)
        else:
            simulate(space, path, force=True)
        wall, cpu = time.perf_counter() - began, _cpu() - cpu
        physics = spent["physics"] or time.thread_time() - own
    return Taken(wall, physics, spent["recorder"], max(0.0, cpu - physics - spent["recorder"])), space.step


def _cpu() -> float:
    used = resource.getrusage(resource.RUSAGE_SELF)
    ended = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime + ended.ru_utime + ended.ru_stime


def only_steps(space: Space) -> None:
    """Take the same steps, with no energies except those of the regular checks."""
    while space.time < space.scene.time.duration:
        space.compute_dynamics(space.step + 1)


def frames_for_nobody(space: Space) -> None:
    """Make every frame, without recording it."""
    for _ in space.run():
        pass


def compare(name: str, rounds: int) -> list[dict[str, Any]]:
    """Measure a scene in all variants, print a table, and return its rows."""
    taken: dict[str, list[Taken]] = {variant: [] for variant in VARIANTS}
    steps = 0
    with tempfile.TemporaryDirectory() as folder:
        for number in range(rounds + 1):  # the first round loads kernels and libraries
            for variant in VARIANTS:
                found, steps = measure(name, variant, Path(folder) / "run.rrd")
                taken[variant] += [found] if number else []
    rows = []
    print(f"\n{name}: {steps} steps, medians of {rounds} rounds; on the right CPU time, ms a step")
    print(f"{'':>20} {'wall s':>8} {'':>8} {'ms a step':>10} {'physics':>8} {'recorder':>9} {'others':>7}")
    for variant, runs in taken.items():
        median = Taken(*(statistics.median(asdict(run)[part] for run in runs) for part in asdict(runs[0])))
        base = taken["only steps"]
        over = statistics.median(run.wall / other.wall for run, other in zip(runs, base, strict=True)) - 1.0
        each = {part: 1e3 * seconds / steps for part, seconds in asdict(median).items()}
        print(
            f"{variant:>20} {median.wall:8.3f} {over:+8.1%} {each['wall']:10.3f} {each['physics']:8.3f} "
            f"{each['recorder']:9.3f} {each['others']:7.3f}"
        )
        rows.append({"scene": name, "variant": variant, "steps": steps, "over": over, **asdict(median)})
    return rows


def default_recordings(names: list[str], rounds: int, whole_commands: bool) -> list[dict[str, Any]]:
    """Compare runs with a default recording and the same runs with the first and the last frame only.

    With ``whole_commands``, compare `carom run` with a process that takes the same steps and does not import Rerun.
    """
    rows = []
    what = "whole processes, least of rounds" if whole_commands else "one thread, least of rounds"
    print(f"{what:>32} {'CPU s':>8} {'recorded':>9} {'':>8} {'wall s':>8} {'recorded':>9}")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "run.rrd"
        for name in names:
            least = dict.fromkeys(("cpu_steps", "cpu_recorded", "wall_steps", "wall_recorded"), np.inf)
            for number in range(rounds + 1):  # the first round loads kernels and libraries
                for variant in ("steps", "recorded"):
                    if whole_commands:
                        words = [sys.executable, "-c", ONLY_STEPS, name]
                        if variant == "recorded":
                            words = [sys.executable, "-m", "carom", "run", name, "-o", str(path), "--force"]
                        act: Callable[[], object] = partial(subprocess.run, words, capture_output=True, check=True)
                    else:
                        space = recording_space(Scene.load(name), 1)
                        act = partial(only_ends, space)
                        if variant == "recorded":
                            act = partial(simulate, space, path, force=True)
                    began, cpu = time.perf_counter(), _cpu()
                    act()
                    for kind, spent in (("wall", time.perf_counter() - began), ("cpu", _cpu() - cpu)):
                        if number:
                            least[f"{kind}_{variant}"] = min(least[f"{kind}_{variant}"], spent)
            line = [f"{name:>32}"]
            for kind in ("cpu", "wall"):
                steps, whole = least[f"{kind}_steps"], least[f"{kind}_recorded"]
                line.append(f"{steps:8.3f} {whole:9.3f} {whole / steps - 1.0:+8.1%}")
            print(" ".join(line), flush=True)
            rows.append({"scene": name, **({"of": "command"} if whole_commands else {}), **least})
    return rows


def only_ends(space: Space) -> None:
    """Run a space without frames between the first and the last one."""
    for _ in space.run(schedule=at(())):
        pass


def compare_writing(rounds: int) -> list[dict[str, Any]]:
    """Compare what default recordings cost with Rerun alone, which writes the same chunks to a file.

    Seconds are CPU times of the process, least of interleaved rounds: of the steps without frames, of the recorded run,
    of the recorder with frames that exist already, and of Rerun.
    """
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for name in WRITTEN:
            path, scene = Path(folder) / f"{name}.rrd", Scene.load(name)
            simulate(recording_space(scene, 1), path, force=True)
            whole = Container.open(path)
            read = [chunk for store in whole.stores for chunk in whole.chunks(store.entries)]
            chunks = [part for chunk in read for part in rerun_chunks(chunk.batch)]
            space = recording_space(scene, 1)
            header, frames = header_of(space), list(space.run())
            contenders: dict[str, Callable[[], object]] = {
                "steps": partial(with_space, scene, only_ends),
                "run": partial(with_space, scene, partial(simulate, path=path, force=True)),
                "recorder": partial(record_frames, path, header, frames),
                "Rerun": partial(write_chunks, path.with_suffix(".peer.rrd"), chunks, PEER_TIMES),
            }
            least = dict.fromkeys(contenders, np.inf)
            for number in range(rounds + 1):  # the first round loads kernels and libraries
                for contender, act in contenders.items():
                    cpu = _cpu()
                    act()
                    if number:
                        least[contender] = min(least[contender], _cpu() - cpu)
            least["Rerun"] /= PEER_TIMES
            rows.append({"scene": name, "frames": len(frames), "s": least})
            print(name, len(frames), {key: f"{1e3 * seconds:.1f} ms" for key, seconds in least.items()}, flush=True)
    return rows


def with_space(scene: Scene, act: Callable[[Space], object]) -> None:
    """Build a space, and act on it."""
    act(recording_space(scene, 1))


def record_frames(path: Path, header: Header, frames: Sequence[Frame]) -> None:
    """Record frames that exist already."""
    with FrameRecorder(path, header) as recorder:
        for frame in frames:
            recorder.put(frame)
        recorder.finish("completed")


def write_chunks(path: Path, chunks: Sequence[Any], times: int) -> None:
    """Write chunks with Rerun alone, several times."""
    for _ in range(times):
        stream = rr.RecordingStream("peer")
        stream.save(path)
        rr.send_chunks(chunks, recording=stream)
        stream.disconnect()


def recorded(space: Space, folder: str) -> tuple[float, Outcome]:
    began = time.perf_counter()
    outcome = simulate(space, Path(folder) / "run.rrd", force=True)
    return time.perf_counter() - began, outcome


def recorded_without_exact_states(space: Space, folder: str) -> float:
    """Record without fingerprints and checkpoints; such a file could be viewed, but not replayed."""
    nothing = mock.patch("carom.state.frame.fingerprint_of", lambda time, arrays: 0)
    never: Any = mock.patch("carom.recording.write.recorder.CheckpointPlan.chosen", lambda plan, batch: [])
    with nothing, never:
        return recorded(space, folder)[0]


def details(rounds: int) -> None:
    """Print the cost of exact states in a recording of 1000 bodies, the size of its file, and the memory."""
    whole, bare = [], []
    with tempfile.TemporaryDirectory() as folder:
        for _ in range(rounds):
            seconds, outcome = recorded(recording_space(scene("1000-bodies", "auto")), folder)
            whole.append(seconds)
            bare.append(recorded_without_exact_states(recording_space(scene("1000-bodies", "auto")), folder))
    print(f"\nfingerprints and checkpoints: {statistics.median(whole) / statistics.median(bare) - 1:+.1%}")
    print(f"file: {outcome.size / outcome.payload:.3f} of its payload")
    print(f"peak memory: {peak_memory(2000.0):.0f} MB for 2000 s, {peak_memory(8000.0):.0f} MB for 8000 s simulated")


def peak_memory(duration: float) -> float:
    """Return the peak resident memory in MB of a process that records a run of this duration."""
    code = f"import recording; recording.record_once({duration})"
    here = Path(__file__).parent
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=here)
    return float(done.stdout.strip())


def record_once(duration: float) -> None:
    SCENES["short"] = ("cloud-collapse", [*THOUSAND[:-1], f"time.duration={duration}"])
    with tempfile.TemporaryDirectory() as folder:
        recorded(recording_space(scene("short", "auto")), folder)
    print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", nargs="*", help=f"of {', '.join(SCENES)} (default: all)")
    parser.add_argument("--rounds", type=int, default=ROUNDS)
    parser.add_argument("--default", action="store_true", help="default recordings of bundled scenes")
    parser.add_argument("--commands", action="store_true", help="the same of whole processes")
    parser.add_argument("--writing", action="store_true", help="frames beside Rerun, which writes the same data")
    parser.add_argument("--details", action="store_true", help="what exact states take, and memory")
    options = parser.parse_args()
    if options.details:
        details(options.rounds)
        return
    if options.writing:
        print(f"\n{merge('recording', {'writing': compare_writing(options.rounds)})}")
        return
    if options.default or options.commands:
        rows = default_recordings(options.scenes or sorted(bundled_scenes()), options.rounds, options.commands)
        print(f"\n{merge('recording', {'default': rows})}")
        return
    rows = [row for name in options.scenes or SCENES for row in compare(name, options.rounds)]
    print(f"\n{merge('recording', {'recording': rows})}")


if __name__ == "__main__":
    main()
