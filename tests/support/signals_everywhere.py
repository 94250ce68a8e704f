"""Signals at random moments of random commands: one, or two as wrappers, schedulers and closed terminals send them.

    python signals_everywhere.py SEED COUNT

prints a line of JSON for each: the command, the signals, how it ended, and what is wrong with that, if anything.
"""

from __future__ import annotations

import json
import random
import shlex
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from carom.errors import RecordingError
from carom.recording.edit.repair import repair
from carom.recording.read.recording import Recording

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
LATEST = 6.0  # s after the start of a command, by which most have ended on a quiet machine, where `USUAL` is true
USUAL = 3.0  # s that a short run takes there; where it takes longer, commands are given as much more time
PATIENCE = 60.0  # s after the last signal
SCENE = "rack-break -o made.rrd --force --set time.duration={}"
COMMANDS = (  # all of them
    f"run {SCENE.format(0.2)}",
    f"run {SCENE.format(1000)}",
    "replay run.rrd",
    "resume part.rrd -o made.rrd --force --until 100",
    "clip run.rrd --from 0 --to 0.1 -o made.rrd --force",
    "repair part.rrd -o made.rrd --force",
    "inspect run.rrd",
    "why run.rrd --body 0 --at 0.1",
    "fork run.rrd --at 0.05 --perturb 1ulp --seeds 4 -o made.rrd --force",
    "sweep rack-break --vary seed=1,2 --set time.duration=0.05 -o sweep",
    "explain rack-break",
    *("scenes", "new made.toml --force", "warmup", "view run.rrd", "contacts run.rrd --impacts -o made.csv --force"),
    *("picture run.rrd -o made.png --force", "movie run.rrd -o made.mp4 --force --seconds 2"),
    *("fields run.rrd --cell 0.1 -o made.npz --force", "diff run.rrd part.rrd", "export run.rrd -o made.csv --force"),
    *("report run.rrd -o made.zip --force", "publish run.rrd -o page --force", "stress never-meet -o stress"),
    *("shrink run.rrd --while 'contacts.total > 3' -o made.toml --force", "hunt --scenes 30 --budget 20s -o hunt"),
    *("tradeoff rack-break --set time.duration=0.05 -o trade", "crosscheck two-spheres --engine mujoco -o crosscheck"),
    "tune rack-break --set time.duration=0.05 --error position=1e-3 -o made.toml --force",
)


def fault_of(code: int, said: str, folder: Path) -> str:
    """Return what is wrong with the end of a command."""
    if "Traceback" in said or "Exception ignored" in said:
        return "traceback"
    if code not in (0, 1, 2, *(128 + number for number in SIGNALS)):
        return f"exit code {code}"
    for path in folder.glob("made*.rrd"):
        try:
            if not Recording.open(path).finished:
                repair(path, folder / "fixed.rrd")
        except RecordingError as error:
            if "nothing" not in str(error):
                return f"{path.name}: {error}"
    return ""


def attempt(rng: random.Random, folder: Path, slowness: float) -> dict[str, object]:
    """Send signals to a command, and judge its end, on a machine that is slower by a factor."""
    command = rng.choice(COMMANDS)
    sent = [rng.choice(SIGNALS) for _ in range(rng.choice((1, 2, 2)))]
    waits = [slowness * rng.uniform(0.3, LATEST), *(rng.choice((0.0, 0.05, 0.4, 1.0)) for _ in sent[1:])]
    with subprocess.Popen(
        [sys.executable, "-m", "carom", *shlex.split(command)],
        cwd=folder,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        start_new_session=True,
    ) as child:
        for number, wait in zip(sent, waits, strict=True):
            time.sleep(wait)
            child.send_signal(number)
        try:
            said, _ = child.communicate(timeout=slowness * PATIENCE)
        except subprocess.TimeoutExpired:
            child.kill()
            said, _ = child.communicate()
            said += "\nTraceback: it did not end"
    fault = fault_of(child.returncode, said, folder)
    for path in folder.glob("made*"):
        path.unlink()
    (folder / "fixed.rrd").unlink(missing_ok=True)
    answer: dict[str, object] = {"command": command, "sent": [number.name for number in sent], "waits": waits}
    return answer | {"code": child.returncode, "faults": [fault] if fault else [], "said": said[-300:] if fault else ""}


def main(seed: str, count: int) -> int:
    """Judge so many attempts; return the number of faults."""
    # a shell that starts us in the background has us ignore the interrupt key, and commands would inherit that
    signal.signal(signal.SIGINT, signal.default_int_handler)
    rng, faults = random.Random(seed), 0
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        start = [sys.executable, "-m", "carom", "run", *shlex.split(SCENE.format(0.2))]
        began = time.monotonic()
        subprocess.run(start, cwd=folder, check=True, capture_output=True)
        slowness = max(1.0, (time.monotonic() - began) / USUAL)
        content = (folder / "made.rrd").read_bytes()
        (folder / "run.rrd").write_bytes(content)
        (folder / "part.rrd").write_bytes(content[: 2 * len(content) // 3])
        repair(folder / "part.rrd", folder / "whole.rrd")
        (folder / "whole.rrd").replace(folder / "part.rrd")
        (folder / "made.rrd").unlink()
        for _ in range(count):
            found = attempt(rng, folder, slowness)
            faults += bool(found["faults"])
            print(json.dumps(found), flush=True)  # noqa: T201
    return faults


if __name__ == "__main__":
    sys.exit(main(sys.argv[1], int(sys.argv[2])) > 0)
