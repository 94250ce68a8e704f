"""What takes long or needs a strange machine: kills under load, a soak, both forms of kernels, no locks, 2³¹ bytes.

    python endurance.py KIND SEED AMOUNT

prints a line of JSON for each attempt, and exits with 1 after a fault. `KINDS` says what the amount counts.
"""

from __future__ import annotations

import contextlib
import json
import os
import random
import shlex
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from carom.errors import RecordingError
from carom.recording.edit.repair import repair
from carom.recording.read.recording import Recording
from carom.runs.replay import replay
from signals_everywhere import COMMANDS, SCENE

Attempt = dict[str, Any]
CAROM = (sys.executable, "-m", "carom")
# in turn: while it loads kernels, at any byte of its file, after the interrupt key of a long run, at any moment
PHASES = ("start", "writing", "ending", "any")
START = 1.2  # s of processor time, in which a command loads modules and kernels
LATEST = 5.0  # s of processor time; commands that end by themselves take 2 to 4
ENDING = 0.3  # s of processor time, in which most commands write layout and footer after an interrupt
PATIENCE = 120.0  # s, for a command that waits for another
POLL = 0.002  # s between two looks at a process and its file
# Bytes by which a soak may grow in its second half: batches are joined, so that twice the data are at most ln 2 / 0.004
# = 173 batches more (docs/recording.md, "Long runs") of 60 messages, for each of which Rerun keeps 6 kB.
GROWTH = 64_000_000
MANY = "[[group]]\ncount = 200000\nradius = 0.01\nvelocity = {{ dispersion = 0.1 }}\n[gravity]\nconstant = 0.0\n"
MANY += '[contact]\nenabled = false\n[time]\nfixed_dt = 0.01\nduration = {}\n[record]\nevery = "step"\n'
BYTES_PER_FRAME = 2_500_000  # at least, of these bodies
# Python's standard library as on a file system without locks, by a clock that goes back an hour with each question
ODD = """
import errno, fcntl, itertools, sys, time

def refused(*_): raise OSError(errno.ENOLCK, "No locks available")

fcntl.flock = fcntl.lockf = refused
now, back = time.time, itertools.count()
time.time = lambda: now() - 3600.0 * next(back)
from carom.__main__ import main
sys.exit(main())
"""
PLAIN = """
import json, sys
from carom.lab.hunt.alone import last_ending

seed, first, count = map(int, sys.argv[1:])
for index in range(first, first + count):
    end = last_ending([(seed, index)])
    print(json.dumps(None if end is None else [end.step, end.fingerprint, end.error]), flush=True)
"""


def say(command: str, folder: Path, start: tuple[str, ...] = CAROM, **environment: str) -> tuple[int, str]:
    """Run a command; return its exit code and what it said."""
    done = subprocess.run(
        [*start, *shlex.split(command)],
        cwd=folder,
        env=os.environ | environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        check=False,
    )
    return done.returncode, done.stdout


def fault_of(path: Path, folder: Path) -> str:
    """Return what is wrong with a recording whose command was killed, and with its repaired copy."""
    try:
        repair(path, folder / "fixed.rrd")
        for each in filter(Path.exists, (path, folder / "fixed.rrd")):  # a whole one is not written again
            if (recording := Recording.open(each)).frames and not (result := replay(recording)).same:
                return f"{each.name}: {result.difference}"
    except RecordingError as error:
        known = ("nothing", "checkpoint", "first frame", "several runs")  # forks are only viewed
        return "" if any(word in str(error) for word in known) else f"{path.name}: {error}"
    finally:
        (folder / "fixed.rrd").unlink(missing_ok=True)
    return ""


def worked(pid: int) -> float:
    """Return the processor time (s) of a process, which counts alike on a quiet machine and on a busy one."""
    with contextlib.suppress(FileNotFoundError, ProcessLookupError):
        fields = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
    return float("inf")


def kill(rng: random.Random, phase: str, child: subprocess.Popen[bytes], folder: Path, size: int) -> bool:
    """Kill a command in a phase; tell whether it was not over. Its file becomes about so many bytes long."""
    moment, length = rng.uniform(0.0, START if phase == "start" else LATEST), rng.uniform(0.0, size)
    began, by_bytes = time.monotonic(), phase in ("writing", "ending")
    earlier = {each.stat().st_ino for each in folder.iterdir()}

    def is_long() -> bool:
        with contextlib.suppress(FileNotFoundError):  # renamed meanwhile
            new = [each.stat() for each in folder.glob("*made*") if each.suffix in (".part", ".rrd")]
            return any(each.st_size > length and each.st_ino not in earlier for each in new)
        return False

    def waits(until: float) -> bool:
        time.sleep(POLL)
        return child.poll() is None and worked(child.pid) < until and time.monotonic() - began < PATIENCE

    while waits(float("inf") if by_bytes else moment) and not (by_bytes and is_long()):
        pass
    if phase == "ending" and child.poll() is None:
        child.send_signal(signal.SIGINT)
        moment = worked(child.pid) + rng.uniform(0.0, ENDING)
        while waits(moment):
            pass
    if child.poll() is None:
        os.killpg(child.pid, signal.SIGKILL)
        return True
    return False


def kills(rng: random.Random, folder: Path, amount: int) -> Iterator[Attempt]:
    """Kill so many commands that write, in each of `PHASES`, while two programs keep the processors busy."""
    code, said = say(f"run {SCENE.format(0.2)}", folder)
    assert code == 0, said
    content = (folder / "made.rrd").read_bytes()
    for name, size in (("run.rrd", len(content)), ("cut.rrd", 2 * len(content) // 3)):
        (folder / name).write_bytes(content[:size])
    repair(folder / "cut.rrd", folder / "part.rrd")
    busy = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(2)]
    try:
        done = 0
        while done < amount:
            phase = PHASES[done % len(PHASES)]
            writing = [each for each in COMMANDS if "made.rrd" in each and (phase != "ending" or "100" in each)]
            command = rng.choice(writing).replace("repair part", "repair cut")  # a whole one is not written again
            was_there = rng.random() < 0.5
            if was_there:
                (folder / "made.rrd").write_bytes(content)
            with subprocess.Popen(
                [*CAROM, *shlex.split(command)],
                cwd=folder,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
                start_new_session=True,
            ) as child:
                killed = kill(rng, phase, child, folder, len(content))
            done += killed
            found = [each for each in folder.iterdir() if "made" in each.name and each.stat().st_size]
            faults = [fault for each in found if each.read_bytes() != content and (fault := fault_of(each, folder))]
            if was_there and not (folder / "made.rrd").exists():
                faults.append("the earlier recording is gone")
            for path in folder.iterdir():
                if path.name not in ("run.rrd", "part.rrd", "cut.rrd") and path.is_file():
                    path.unlink()
            yield {"command": command, "phase": phase, "killed": killed, "left": len(found), "faults": faults}
    finally:
        for each in busy:
            each.kill()
            each.wait()


def soak(rng: random.Random, folder: Path, amount: int) -> Iterator[Attempt]:
    """Let a run record for so many seconds; in the second half its memory must not grow by more than `GROWTH`."""
    command = "run two-spheres -o made.rrd --set time.duration=1e9 --set time.fixed_dt=0.001 --set record.every=0.01"
    sizes, began, every = list[int](), time.monotonic(), min(1.0, amount / 50)
    with subprocess.Popen(
        [*CAROM, *shlex.split(command)], cwd=folder, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
    ) as child:
        while time.monotonic() - began < amount and child.poll() is None:
            time.sleep(every)
            pages = Path(f"/proc/{child.pid}/statm").read_text(encoding="ascii").split()[1]
            sizes.append(int(pages) * os.sysconf("SC_PAGE_SIZE"))
        child.send_signal(signal.SIGINT)
        _, said = child.communicate()
    half = len(sizes) // 2
    early, late = max(sizes[:half]), max(sizes[half:])
    faults = [] if late - early <= GROWTH else [f"{late - early} bytes more"]
    recording = Recording.open(folder / "made.rrd")
    if not recording.finished:
        faults.append(f"no footer: {said[-300:]}")
    size, megabytes = (folder / "made.rrd").stat().st_size, [each // 10**6 for each in (early, late)]
    yield {"seconds": amount, "MB": megabytes, "frames": recording.frames, "file": size, "faults": faults}


def forms(rng: random.Random, folder: Path, amount: int) -> Iterator[Attempt]:
    """Run random scenes with plain and with optimised kernels, which must give the same bits."""
    seed = rng.randrange(2**31)
    start, which = (sys.executable, "-c", PLAIN), (str(seed), "0", str(amount))
    # no optimisation of the compiler moves a bit: with few of them it takes a fraction of the time
    quick = {"NUMBA_OPT": "1", "NUMBA_CACHE_DIR": str(folder / "kernels"), "CAROM_PLAIN": "1"}
    code, fast = say(shlex.join(which), folder, start)
    ends = fast.splitlines()
    if code or len(ends) != amount:
        yield {"seed": seed, "faults": [fast[-600:]]}
        return
    with subprocess.Popen(
        [*start, *which],
        cwd=folder,
        env=os.environ | quick,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    ) as child:
        assert child.stdout is not None
        for index, end in enumerate(ends):  # each as soon as it is there: the first ones compile for minutes
            plain = child.stdout.readline().strip()
            yield {"seed": seed, "index": index, "end": end, "faults": [] if plain == end else [f"plain: {plain}"]}


def odd(rng: random.Random, folder: Path, amount: int) -> Iterator[Attempt]:
    """Run commands without file locks, by a clock that goes back, on files of the future."""
    start = (sys.executable, "-c", ODD)
    commands = [f"run {SCENE.format(0.05)}", "replay made.rrd", "resume made.rrd -o more.rrd --force --until 0.1"]
    commands += ["clip made.rrd --from 0 --to 0.02 -o part.rrd --force", "repair made.rrd -o fixed.rrd --force"]
    commands += ["sweep two-spheres --vary seed=1,2 --set time.duration=0.05 -o sweep --force", "explain two-spheres"]
    for _ in range(amount):
        for command in commands:
            code, said = say(command, folder, start)
            refused = code == 2 and "lock" in said and "Traceback" not in said
            faults = [] if (code == 0 or refused) and "Traceback" not in said else [said[-400:]]
            yield {"command": command, "code": code, "faults": faults, "said": said[-200:] if refused else ""}
        for path in folder.rglob("*"):
            os.utime(path, (2**32, 2**32))


def large(rng: random.Random, folder: Path, amount: int) -> Iterator[Attempt]:
    """Record, read, clip, cut, repair and replay a recording of at least so many bytes, such as 2³¹ + 1."""
    frames = amount // BYTES_PER_FRAME + 2
    (folder / "many.toml").write_text(MANY.format(0.01 * frames), encoding="ascii")
    commands = [
        "run many.toml -o made.rrd",
        "inspect made.rrd",
        "replay made.rrd --to 0.3",
        f"clip made.rrd --from {0.01 * frames - 0.05:g} -o end.rrd",
    ]
    commands += ["inspect end.rrd", "repair cut.rrd -o fixed.rrd", "inspect fixed.rrd", "replay fixed.rrd --to 0.3"]
    for command in commands:
        began = time.monotonic()
        if command.startswith("repair"):
            os.truncate(folder / "made.rrd", (folder / "made.rrd").stat().st_size - 1000)
            (folder / "made.rrd").rename(folder / "cut.rrd")
        code, said = say(command, folder)
        size = max(path.stat().st_size for path in folder.glob("*.rrd"))
        faults = [] if code == 0 and "Traceback" not in said else [said[-400:]]
        faults += [f"only {size} bytes"] if size < amount else []
        yield {"command": command, "bytes": size, "s": round(time.monotonic() - began), "faults": faults}


KINDS = {"kills": kills, "soak": soak, "forms": forms, "odd": odd, "large": large}  # attempts, s, scenes, rounds, bytes


def main(kind: str, seed: str, amount: int) -> int:
    """Make attempts of a kind; return the number of faults."""
    # a shell that starts us in the background has us ignore the interrupt key, and commands would inherit that
    signal.signal(signal.SIGINT, signal.default_int_handler)
    faults = 0
    with tempfile.TemporaryDirectory() as folder:
        for found in KINDS[kind](random.Random(seed), Path(folder), amount):
            faults += bool(found["faults"])
            print(json.dumps(found), flush=True)  # noqa: T201
    return faults


if __name__ == "__main__":
    sys.exit(main(sys.argv[1], sys.argv[2], int(sys.argv[3])) > 0)
