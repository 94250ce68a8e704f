"""Compiles all kernels ahead of time, by running a few tiny scenes that need all of them."""

from __future__ import annotations

import contextlib
import time
from dataclasses import dataclass
from typing import Any

import numpy as np

from carom.physics.contact.broad_phase.grid import ALL_PAIRS_UP_TO
from carom.physics.contact.islands import number_sets
from carom.physics.forces.gravity.direct import MAX_IN_ONE_BLOCK
from carom.physics.jit.decorators import Compilations, cache_folder, compiling_all
from carom.physics.jit.team import load_helpers, sharing_all
from carom.private_folder import temporary_folder
from carom.registry import ExtensionError
from carom.runs.run import run
from carom.scene.schema import Scene

# Together these scenes need every kernel. Add a scene for a kernel that none of them needs (a test checks this).
_PAIR = [{"position": [-1.0, 0.0, 0.0], "mass": 1.0}, {"position": [0.9999, 0.1, 0.0], "mass": 1.0}]
_CROWD = [{"count": 8, "radius": {"min": 0.1, "max": 0.4}, "velocity": {"dispersion": 1.0}}]
SCENES: dict[str, dict[str, Any]] = {
    "a pile, recorded": {
        "body": _PAIR,
        "plane": [{"point": [0.0, 0.0, -1.0]}],
        "gravity": {"constant": 1.0, "uniform": [0.0, 0.0, -1.0]},
        "contact": {"allow_overlap": True, "sweeps": 1, "sleep": {"speed": 0.01}},
        "time": {"duration": 0.2, "max_dt": 0.02},
        "expect": {"contact_audit": 1e-12},
        "record": {"every": "step", "check_every": 2},
    },
    "a pile without friction": {
        "body": _PAIR,
        "plane": [{"point": [0.0, 0.0, -1.0]}],
        "gravity": {"constant": 0.0, "uniform": [0.0, 0.0, -1.0]},
        "contact": {"allow_overlap": True, "static_friction": 0.0},
        "time": {"duration": 0.1, "max_dt": 0.02},
    },
    "points that attract each other": {
        "body": _PAIR,
        "gravity": {"constant": 1.0},
        "contact": {"enabled": False},
        "time": {"duration": 0.1, "max_dt": 0.02},
    },
    "points that keep an accuracy": {
        "body": _PAIR,
        "gravity": {"constant": 1.0},
        "contact": {"enabled": False},
        "time": {"duration": 0.1, "accuracy": 1e-6},
    },
    "points that kick and drift": {
        "body": _PAIR,
        "gravity": {"constant": 1.0},
        "contact": {"enabled": False},
        "time": {"duration": 0.1, "max_dt": 0.02, "integrator": "leapfrog"},
    },
    "a crowd, in lanes": {
        "group": [_CROWD[0] | {"count": MAX_IN_ONE_BLOCK + 1}],
        "gravity": {"constant": 1.0},
        "contact": {"enabled": False},
        "time": {"duration": 0.1, "max_dt": 0.02, "integrator": "leapfrog"},
    },
    "a cloud, by the tree": {
        "group": [_CROWD[0] | {"count": 2 * ALL_PAIRS_UP_TO}],
        "gravity": {"constant": 1.0, "method": "tree"},
        "time": {"duration": 0.1, "max_dt": 0.02},
    },
    "a cloud, by fast multipoles": {
        "group": [_CROWD[0] | {"count": 2 * ALL_PAIRS_UP_TO}],
        "gravity": {"constant": 1.0, "method": "fast-multipole"},
        "contact": {"enabled": False},
        "time": {"duration": 0.1, "max_dt": 0.02},
    },
    "a periodic box, bodies coloured": {
        "group": _CROWD,
        "domain": {"boundary": "periodic", "size": [4.0, 4.0, 4.0]},
        "gravity": {"constant": 0.0},
        "contact": {"colouring": "bodies", "stabilisation": "baumgarte"},
        "time": {"duration": 0.2, "max_dt": 0.02, "velocity_limit": "fastest-body"},
    },
    "impacts within the step": {
        "group": _CROWD,
        "plane": [{"point": [0.0, 0.0, -2.0]}],
        "gravity": {"constant": 1.0},
        "contact": {"timing": "time-of-impact"},
        "time": {"duration": 0.2, "max_dt": 0.02},
        "expect": {"contact_audit": 1e-12},
    },
    "impacts found on polynomials": {
        "body": [{"position": [-1.2, 0.0, 0.0], "mass": 1.0}, {"position": [1.2, 0.1, 0.0], "mass": 1.0}],
        "plane": [{"point": [0.0, 0.0, -1.5]}],
        "gravity": {"constant": 1.0, "uniform": [0.0, 0.0, -1.0]},
        "contact": {"restitution": 1.0},
        "time": {"duration": 3.0, "max_dt": 1.0, "integrator": "gauss-radau15"},
    },
    "spheres that grow to a dense packing": {
        "group": [_CROWD[0] | {"arrangement": "compressed", "region": {"radius": 0.8}}],
        "time": {"duration": 0.02, "max_dt": 0.02},
    },
    "planets with close encounters": {
        "body": [
            {"position": [0.0, 0.0, 0.0], "mass": 1.0},
            {"position": [1.0, 0.0, 0.0], "velocity": [0.0, 1.0, 0.0], "mass": 1e-5},
            {"position": [0.92, 0.5, 0.0], "velocity": [-0.466, 0.858, 0.0], "mass": 1e-5},
        ],
        "gravity": {"constant": 1.0},
        "contact": {"enabled": False, "allow_overlap": True},
        "time": {"duration": 8.0, "max_dt": 1.0, "integrator": "wisdom-holman"},
    },
    "a ball that rolls on": {
        "body": [{"position": [0.0, 0.0, 0.0], "velocity": [1.0, 0.0, 0.0], "mass": 1.0}],
        "plane": [{"point": [0.0, 0.0, -1.0]}],
        "gravity": {"constant": 0.0, "uniform": [0.0, 0.0, -1.0]},
        "time": {"duration": 0.2, "max_dt": 0.02},
        "record": {"every": 0.2},
    },
    "a ball that a field drives along a periodic axis": {
        "body": [{"position": [0.0, 0.0, 0.0], "mass": 1.0}],
        "plane": [{"point": [0.0, 0.0, -1.0]}],
        "domain": {"boundary": ["periodic", "periodic", "open"], "size": [4.0, 4.0, 4.0]},
        "gravity": {"constant": 0.0, "uniform": [1.0, 0.0, -1.0]},
        "time": {"duration": 0.1, "max_dt": 0.02},
    },
    "a pile in a wind, and falling bodies": {
        "body": [*_PAIR, {"position": [0.0, 0.0, 2.2], "velocity": [0.0, 0.0, -5.0], "mass": 1.0}],
        "plane": [{"point": [0.0, 0.0, -1.0]}],
        "gravity": {"constant": 0.0, "uniform": [0.0, 0.0, -1.0]},
        "contact": {"allow_overlap": True},
        "drag": {"relaxation_time": 1.0, "medium_velocity": [1.0, 0.0, 0.0]},
        "time": {"duration": 0.2, "max_dt": 0.02},
    },
}


@dataclass(frozen=True, slots=True)
class Warmth:
    """Result of a warm-up."""

    seconds: float
    compiled: int  # number of kernels; the others were in the cache
    cache: str  # the folder of compiled kernels; empty without a cache


def warm_up() -> Warmth:
    """Run the scenes, which compiles all kernels that are not in the cache."""
    began = time.perf_counter()
    with Compilations() as compilations, temporary_folder() as folder, sharing_all(), compiling_all():
        for name, document in SCENES.items():
            with contextlib.suppress(ExtensionError):  # a part that has been removed
                run(Scene.from_dict({"title": name, **document}), folder / "warm-up.rrd", force=True)
        nothing = np.empty(0, dtype=np.int64)
        number_sets(nothing, nothing, nothing)  # needed by the audit of other engines
        load_helpers()
    return Warmth(time.perf_counter() - began, compilations.count, cache_folder())
