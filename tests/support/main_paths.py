"""The main path of every command. ``python tests/support/main_paths.py`` tries them in an environment without extras.

A command may need an extra or a screen; then it says so in one sentence, with the line that installs it.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

EXTRAS = (
    *("distributed", "matplotlib", "h5py", "rebound", "mujoco", "pybullet", "robox3d", "newton", "warp"),
    *("imageio_ffmpeg", "datafusion", "pandas", "rerun_notebook", "cryptography"),
)  # what they install, by the names that are imported
SHORT = ("--set", "time.duration=2", "--set", "time.fixed_dt=0.05", "--set", "record.every=step")
PATHS: dict[str, list[tuple[int, str, str]]] = {  # by command: exit code, what it says, and its arguments
    "run": [(0, "completed", "two-spheres -o run.rrd")],
    "scenes": [(0, "two-spheres", "")],
    "new": [(0, "mine.toml", "mine")],
    "explain": [(0, "", "two-spheres")],
    "resume": [(0, "", "run.rrd --until 2.2 -o longer.rrd")],
    "sweep": [
        (0, "2 of 2 runs done", "two-spheres --seeds 2 --workers 2 -o sweep"),
        (0, "seed", "--table sweep"),
        (2, "'distributed>=", "two-spheres --seeds 2 -o other --cluster tcp://localhost:9"),
        (2, "pip install 'matplotlib>=", "--table sweep --plot x=seed y=steps"),
        (2, "pip install 'rerun-sdk[catalog]", "--catalog sweep"),
    ],
    "warmup": [(0, "", "")],
    "view": [(2, "there is no screen", "run.rrd")],
    "picture": [(2, "mesa-vulkan-drivers", "run.rrd -o run.png")],
    "movie": [(2, "pip install 'imageio-ffmpeg>=", "run.rrd -o run.mp4")],
    "inspect": [(0, "completed", "run.rrd")],
    "contacts": [(0, "", "run.rrd --impacts"), (0, "", "run.rrd --impacts -o impacts.parquet")],
    "why": [(0, "", "run.rrd --event impact")],
    "replay": [(0, "", "run.rrd")],
    "diff": [(0, "", "run.rrd run.rrd")],
    "fork": [
        (0, "", "run.rrd --at 0.1 --set contact.restitution=0.5"),
        (0, "2 forks", "run.rrd --at 0.1 --perturb 1ulp --seeds 2 -o forks.rrd"),
    ],
    "shrink": [(0, "", "two-spheres --while 'contacts.total > 0' --workers 2 -o small.toml")],
    "tradeoff": [(0, "no figure: ", "two-spheres --set time.duration=0.2 -o trade")],
    "tune": [(0, "", "two-spheres --set time.duration=0.2 --error position=1e-3 -o tuned.toml")],
    "stress": [(0, "", "never-meet -o stress")],
    "hunt": [(0, "No law was broken", "--seed 1 --scenes 3 -o hunt")],
    "crosscheck": [(2, "pip install mujoco", "two-spheres --engine mujoco -o crosscheck")],
    "clip": [(0, "", "run.rrd --from 0.1 --to 0.3 -o clip.rrd")],
    "repair": [(0, "", "run.rrd -o repaired.rrd")],
    "report": [(0, "mesa-vulkan-drivers", "run.rrd -o report.zip")],
    "publish": [(0, "mesa-vulkan-drivers", "run.rrd -o page")],
    "export": [(0, "", "run.rrd -o run.npz")],
}
FIRST = "run"  # the others read its recording


def without_screen_and_driver() -> dict[str, str]:
    """Return an environment in which no window opens, and in which the Vulkan loader and Mesa find no driver."""
    hidden = ("DISPLAY", "WAYLAND_DISPLAY", "WAYLAND_SOCKET")
    kept = {name: value for name, value in os.environ.items() if name not in hidden}
    nowhere = ("VK_DRIVER_FILES", "VK_ICD_FILENAMES", "LIBGL_DRIVERS_PATH", "__EGL_VENDOR_LIBRARY_FILENAMES")
    return {**kept, **dict.fromkeys(nowhere, "/nowhere"), "COLUMNS": "200"}


def fault_of(command: str, path: tuple[int, str, str], folder: Path, environment: dict[str, str]) -> str:
    """Run a path of a command; return what is wrong with its result, or nothing."""
    import shlex

    code, said, arguments = path
    extra = SHORT if command in ("run", "sweep", "shrink") and arguments.startswith("two-spheres") else ()
    ran = subprocess.run(
        [sys.executable, "-m", "carom", command, *shlex.split(arguments), *extra],
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
        timeout=900,
    )
    both = ran.stdout + ran.stderr
    if ran.returncode == code and said in both and "Traceback" not in both:
        return ""
    return f"carom {command} {arguments}: exit code {ran.returncode} in place of {code}, or not {said!r}:\n{both}"


def main() -> None:
    """Run all paths: the first command alone, then two commands at a time."""
    with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor(2) as threads:

        def fault_in(command: str) -> str:
            faults = (fault_of(command, path, Path(folder), without_screen_and_driver()) for path in PATHS[command])
            return next(filter(None, faults), "")

        others = (name for name in PATHS if name != FIRST)
        if fault := fault_in(FIRST) or next(filter(None, threads.map(fault_in, others)), ""):
            sys.exit(fault)
    print(f"{sum(map(len, PATHS.values()))} paths of {len(PATHS)} commands")  # noqa: T201


if __name__ == "__main__":
    main()
