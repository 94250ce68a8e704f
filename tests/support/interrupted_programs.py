"""Ctrl-C at random moments of programs that go on after it, as notebooks do, and run their scene again and again.

    python interrupted_programs.py SEED COUNT

prints a line of JSON for each program: its scene, when it was interrupted and how the runs ended, and what is wrong, if
anything. The last run of a program, which nothing interrupts, must give the bits of a program that nobody interrupted.
"""

from __future__ import annotations

import json
import random
import subprocess
import sys
import tempfile
from pathlib import Path

# each with parts that the others do without: a search for neighbours, units, an accuracy, trees
SCENES: tuple[tuple[str, list[str]], ...] = (
    ("two-spheres", []),
    ("rack-break", ["time.duration=0.05"]),
    ("figure-eight", ["time.duration=1", "time.fixed_dt=", "time.accuracy=1e-6"]),
    ("cloud-collapse", ["time.duration=0.1"]),
    ("asteroid-belt", ["time.duration=1 d"]),
)
ATTEMPTS = 6
LATEST = 1.5  # s, within which each attempt is interrupted: the first one imports for a second
PATIENCE = 120.0  # s

PROGRAM = """
import json, signal, sys, threading
from pathlib import Path

name, changes, waits, folder = json.loads(sys.argv[1])
ended = []
signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell that starts us in the background ignores it

def attempt():
    import carom

    recording = carom.run(carom.Scene.load(name, changes), Path(folder) / "run.rrd", force=True)
    recording.checkpoint(recording.checkpoint_steps[-1])
    return recording.trajectory(0).to_pydict()

for wait in waits:
    timer = threading.Timer(wait, signal.pthread_kill, (threading.main_thread().ident, signal.SIGINT))
    try:
        timer.start()
        try:
            attempt()
            ended.append("whole")
        finally:
            timer.cancel()
            timer.join()
    except KeyboardInterrupt:
        ended.append("interrupted")
print(json.dumps([ended, attempt()]))
"""


def program(name: str, changes: list[str], waits: list[float], folder: Path) -> tuple[list[str], object, str]:
    """Run a program; return how its runs ended, the result of the last one, and what it wrote to its errors."""
    command = [sys.executable, "-c", PROGRAM, json.dumps([name, changes, waits, str(folder)])]
    done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE, check=False)
    ended, result = json.loads(done.stdout) if done.returncode == 0 else ([], None)
    return ended, result, done.stderr


def fault_of(name: str, changes: list[str], waits: list[float], folder: Path) -> tuple[list[str], str]:
    """Interrupt a program; return how its runs ended, and what is wrong."""
    _, expected, _ = program(name, changes, [], folder)
    ended, result, said = program(name, changes, waits, folder)
    if result is None or said:
        return ended, said[-600:]
    return ended, "" if result == expected else "other bits"


def main(seed: str, count: int) -> int:
    """Judge so many programs; return the number of faults."""
    rng, faults = random.Random(seed), 0
    with tempfile.TemporaryDirectory() as folder:
        for _ in range(count):
            name, changes = rng.choice(SCENES)
            waits = [rng.uniform(0.0, LATEST) for _ in range(ATTEMPTS)]
            ended, fault = fault_of(name, changes, waits, Path(folder))
            faults += bool(fault)
            found = {"scene": name, "waits": waits, "ended": ended, "faults": [fault] if fault else []}
            print(json.dumps(found), flush=True)  # noqa: T201
    return faults


if __name__ == "__main__":
    sys.exit(main(sys.argv[1], int(sys.argv[2])) > 0)
