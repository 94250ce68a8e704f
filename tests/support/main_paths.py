"""The main path of every command. ``python tests/support/main_paths.py`` tries them in an environment without extras.

A command may need an extra or a screen; then it says so in one sentence, with the line that installs it.
"""

from __future__ import annotations

import contextlib
import importlib
import os
import pkgutil
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
    "fields": [
        (0, "", "run.rrd --cell 1 -o fields.npz"),
        (2, "pip install 'matplotlib>=", "run.rrd --cell 1 -o fields.svg"),
    ],
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

PLAIN = {f"taylor.{name}_one_by_one" for name in ("_attract", "_attract_bodies", "_evaluate")}  # of CAROM_PLAIN=1 only
OF_WALLS = {  # compiled for scenes with a [[wall]], as the kernels of a contact law are for scenes with that law
    *("solids.write_heights", "solids.add_arc_speeds", "solids._distance_of_facets"),
    *("facets._in_leaf", "facets._square_outside"),
    *(f"wall_impacts.{name}" for name in ("_time_to_wall", "_until_path", "_predict_with_solid", "_reach")),
    *(f"facet.{name}" for name in ("_beyond", "_corner", "_insides", "_is_at_corner", "_is_within")),
    *(f"facet.{name}" for name in ("_kind_of_corner", "_kind_of_edge", "_on_border")),
    *("moving_walls.work_of_contacts", "moving_walls.work_of_impacts", "solids.add_load_of_walls"),
    *(f"translating_walls.{name}" for name in ("mean_velocities", "place", "work_at_velocities", "work_in_drift")),
}
OF_SHEAR = {  # compiled for sheared boxes
    *(f"sheared_box.{name}" for name in ("_image", "_wrap", "along_gradient", "in_axes")),
    *("sheared_box._work_of_contacts", "sheared_box._work_of_corrections", "near_pairs._find_near"),
}
OF_PACKAGES = {  # compiled for the forces and laws of each package that calls them
    *("kernel_forces._add", "kernel_forces._energy"),
    *("exponential.exponential", "exponential.logarithm", "exponential.power"),
}


def kernels() -> set[str]:
    """Return the functions that Numba compiles separately, each by the last part of its module and its name."""
    from numba.core.dispatcher import Dispatcher

    import carom

    found = set()
    for module in pkgutil.walk_packages(carom.__path__, "carom."):
        with contextlib.suppress(ImportError):  # it needs an extra, and no kernel does
            for value in vars(importlib.import_module(module.name)).values():
                if isinstance(value, Dispatcher) and value.targetoptions.get("inline") != "always":
                    found.add(f"{value.py_func.__module__.rpartition('.')[2]}.{value.py_func.__name__}")
    return found


def fault_of_warmup(folder: Path, environment: dict[str, str]) -> str:
    """Return what `carom warmup` leaves to compile, or nothing; few other scenes have run in this environment."""
    import carom

    if fault := fault_of("warmup", PATHS["warmup"][0], folder, environment):
        return fault
    cached = {path.name.split("-")[0] for path in Path(carom.__file__).parent.rglob("*.nbc")}
    needed = kernels() - OF_PACKAGES - OF_WALLS - OF_SHEAR - PLAIN
    if left := needed - cached:
        return f"carom warmup has not compiled {sorted(left)}"
    if len(needed) <= 50:
        return f"only {sorted(needed)} are kernels"
    return fault_of("warmup", (0, "0 kernels compiled in ", ""), folder, environment)


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
    """Run all paths: the first command, ``warmup``, so that each kernel is compiled once, then two at a time."""
    environment = without_screen_and_driver()
    with tempfile.TemporaryDirectory() as name, ThreadPoolExecutor(2) as threads:
        folder = Path(name)

        def fault_in(command: str) -> str:
            return next(filter(None, (fault_of(command, path, folder, environment) for path in PATHS[command])), "")

        fault = fault_in(FIRST) or fault_of_warmup(folder, environment)
        others = (name for name in PATHS if name not in (FIRST, "warmup"))
        if fault := fault or next(filter(None, threads.map(fault_in, others)), ""):
            sys.exit(fault)
    print(f"{sum(map(len, PATHS.values()))} paths of {len(PATHS)} commands")  # noqa: T201


if __name__ == "__main__":
    main()
