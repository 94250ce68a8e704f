"""Compiles all kernels ahead of time, in this process or in a second one beside the first run on a machine.

Numba compiles under a global lock, so a thread would gain nothing. Both processes share the cache of compiled kernels,
and no process compiles a kernel that the other process has begun (see `jit.cache`). The second process begins with the
kernels that a run needs last. Compiling ahead only fills the cache; if it fails, the run compiles everything itself.
"""

from __future__ import annotations

import contextlib
import os
import sys
import threading
import time
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from carom.contact_table import CONTACT_ROW
from carom.physics.bodies import Bodies
from carom.physics.contact.broad_phase.grid import ALL_PAIRS_UP_TO
from carom.physics.contact.constraints import CONTACT
from carom.physics.contact.islands import Islands, number_sets
from carom.physics.contact.law import materials_of
from carom.physics.contact.near_pairs import largest_values
from carom.physics.contact.pair_list import search_by
from carom.physics.contact.solver.contact_solver import ContactSolver
from carom.physics.contact.solver.prepare import ImpulseCache
from carom.physics.diagnostics.ledger import with_contacts
from carom.physics.diagnostics.run_monitor import refuse_infinities
from carom.physics.forces.gravity.direct import MAX_IN_ONE_BLOCK
from carom.physics.frame_store import FrameStore
from carom.physics.jit.decorators import Compilations, cache_folder, compiling_all
from carom.physics.jit.team import SOLO, load_helpers, sharing_all
from carom.physics.placement import place
from carom.physics.space import Space
from carom.physics.time_step import Timestep
from carom.plan.auto import StepLimits
from carom.private_folder import temporary_folder
from carom.recording.schema import palette
from carom.recording.write import encoding_kernels as encoding
from carom.recording.write.impact_plan import ImpactPlan
from carom.registry import ExtensionError
from carom.runs.environment import collect_garbage_rarely
from carom.runs.run import recording_space, run
from carom.scene.load import Scene
from carom.scene.matter import pair_coefficients
from carom.scene.start import half_spaces
from carom.scene.units.system import SI
from carom.state.energies import Ledger

# These scenes together need every kernel. For a kernel that none of these scenes needs, add a scene (a test checks
# this).
_PAIR = [{"position": [-1.0, 0.0, 0.0], "mass": 1.0}, {"position": [0.9999, 0.1, 0.0], "mass": 1.0}]
_CROWD = [{"count": 8, "radius": {"min": 0.1, "max": 0.4}, "velocity": {"dispersion": 1.0}}]
_POINTS = {"gravity": {"constant": 1.0}, "contact": {"enabled": False}}
_SHORT, _LONGER = {"duration": 0.1, "max_dt": 0.02}, {"duration": 0.2, "max_dt": 0.02}
SCENES: dict[str, dict[str, Any]] = {
    "a pile, recorded": {
        "body": _PAIR,
        "plane": [{"point": [0.0, 0.0, -1.0]}],
        "gravity": {"constant": 1.0, "uniform": [0.0, 0.0, -1.0]},
        "contact": {"allow_overlap": True, "sweeps": 1, "sleep": {"speed": 0.01}},
        "time": _LONGER,
        "expect": {"contact_audit": 1e-12},
        "record": {"every": "step", "check_every": 2},
    },
    "a pile without friction": {
        "body": _PAIR,
        "plane": [{"point": [0.0, 0.0, -1.0]}],
        "gravity": {"constant": 0.0, "uniform": [0.0, 0.0, -1.0]},
        "contact": {"allow_overlap": True, "static_friction": 0.0},
        "time": _SHORT,
    },
    "points that attract each other": {"body": _PAIR, **_POINTS, "time": _SHORT},
    "points that keep an accuracy": {"body": _PAIR, **_POINTS, "time": {"duration": 0.1, "accuracy": 1e-6}},
    "points that kick and drift": {"body": _PAIR, **_POINTS, "time": _SHORT | {"integrator": "leapfrog"}},
    "a crowd, in lanes": {
        "group": [_CROWD[0] | {"count": MAX_IN_ONE_BLOCK + 1}],
        **_POINTS,
        "time": _SHORT | {"integrator": "leapfrog"},
    },
    "a cloud, by the tree": {
        "group": [_CROWD[0] | {"count": 2 * ALL_PAIRS_UP_TO}],
        "gravity": {"constant": 1.0, "method": "tree"},
        "time": _SHORT,
    },
    "a cloud, by fast multipoles": {
        "group": [_CROWD[0] | {"count": 2 * ALL_PAIRS_UP_TO}],
        "gravity": {"constant": 1.0, "method": "fast-multipole"},
        "contact": {"enabled": False},
        "time": _SHORT,
    },
    "a periodic box, bodies coloured": {
        "group": _CROWD,
        "domain": {"boundary": "periodic", "size": [4.0, 4.0, 4.0]},
        "gravity": {"constant": 0.0},
        "contact": {"colouring": "bodies", "stabilisation": "baumgarte"},
        "time": _LONGER | {"velocity_limit": "fastest-body"},
    },
    "impacts within the step": {
        "group": _CROWD,
        "plane": [{"point": [0.0, 0.0, -2.0]}],
        "gravity": {"constant": 1.0},
        "contact": {"timing": "time-of-impact"},
        "time": _LONGER,
        "expect": {"contact_audit": 1e-12},
    },
    "heavy balls on a light one, which is held": {
        "body": [{"position": [0.0, 0.0, 2.001 * k], "mass": 1e3**k} for k in range(3)],
        "plane": [{"point": [0.0, 0.0, -1.001]}],
        "gravity": {"constant": 0.0, "uniform": [0.0, 0.0, -9.81]},
        "contact": {"restitution": 0.5},
        "time": _SHORT,
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
    "bodies that enter and leave": {
        "group": [{"count": 4, "radius": 0.1, "region": {"radius": 1.0}, "release": {"rate": 50.0}}],
        "outlet": [{"point": [0.0, 0.0, -0.5]}],
        "gravity": {"constant": 0.0, "uniform": [0.0, 0.0, -10.0]},
        "time": {"duration": 1.0, "max_dt": 0.02},
    },
    "a ball that rolls on": {
        "body": [{"position": [0.0, 0.0, 0.0], "velocity": [1.0, 0.0, 0.0], "mass": 1.0}],
        "plane": [{"point": [0.0, 0.0, -1.0]}],
        "gravity": {"constant": 0.0, "uniform": [0.0, 0.0, -1.0]},
        "time": _LONGER,
        "record": {"every": 0.2},
    },
    "a ball that a field drives along a periodic axis": {
        "body": [{"position": [0.0, 0.0, 0.0], "mass": 1.0}],
        "plane": [{"point": [0.0, 0.0, -1.0]}],
        "domain": {"boundary": ["periodic", "periodic", "open"], "size": [4.0, 4.0, 4.0]},
        "gravity": {"constant": 0.0, "uniform": [1.0, 0.0, -1.0]},
        "time": _SHORT,
    },
    "a pile in a wind, and falling bodies": {
        "body": [*_PAIR, {"position": [0.0, 0.0, 2.2], "velocity": [0.0, 0.0, -5.0], "mass": 1.0}],
        "plane": [{"point": [0.0, 0.0, -1.0]}],
        "gravity": {"constant": 0.0, "uniform": [0.0, 0.0, -1.0]},
        "contact": {"allow_overlap": True},
        "drag": {"relaxation_time": 1.0, "medium_velocity": [1.0, 0.0, 0.0]},
        "time": _LONGER,
    },
}


@dataclass(frozen=True, slots=True)
class Warmth:
    """Result of a warm-up."""

    seconds: float
    compiled: int  # number of compiled kernels; the others came from the cache
    cache: str  # the folder of compiled kernels; empty without a cache


QUIET = 2.0  # s; after this time without a compilation, the rest of a scene is expected to compile nothing


def warm_up(scenes: Iterable[Scene] = ()) -> Warmth:
    """Run small scenes and the beginning of ``scenes``, to compile all their kernels that are not in the cache.

    The kernels of walls, of sheared boxes, and of contact laws other than Coulomb's have variants for the features that
    a scene requires. Each variant takes 10 to 20 s, so only ``scenes`` compile them.
    """
    began = time.perf_counter()
    with Compilations() as compilations, temporary_folder() as folder, sharing_all(), compiling_all():
        for name, document in SCENES.items():
            with contextlib.suppress(ExtensionError):  # raised for a part that has been removed
                run(Scene.from_dict({"title": name, **document}), folder / "warm-up.rrd", force=True)
        for scene in scenes:
            compiled, last = compilations.count, time.perf_counter()
            for _ in recording_space(scene).run():
                now = time.perf_counter()
                if compilations.count > compiled:
                    compiled, last = compilations.count, now
                elif now - last > QUIET:
                    break
        nothing = np.empty(0, dtype=np.int64)
        number_sets(nothing, nothing, nothing)  # kernels that the audit of other engines needs
        load_helpers()
    return Warmth(time.perf_counter() - began, compilations.count, cache_folder())


_SPINNING = {"position": [-1.0, 0.0, 0.0], "mass": 1.0, "angular_velocity": [0.0, 0.0, 1.0]}
POINTS: dict[str, Any] = {
    "title": "points that attract each other",
    "body": [_SPINNING, *({"position": [float(k), 0.0, 0.0], "mass": 1.0} for k in range(1, MAX_IN_ONE_BLOCK + 1))],
    **_POINTS,
    "time": _SHORT | {"integrator": "leapfrog"},
}


def compile_ahead() -> None:
    """Compile the kernels of most runs in reverse order, so that both processes meet only once, without waiting."""
    scene = Scene.from_dict(POINTS)
    bodies = Bodies.at_start(place(scene), spins=True, orients=True, torques=True)
    _compile_encoding()
    _compile_second_steps(bodies)
    Timestep(scene.time, StepLimits(0.02, 0.5, 0.01), np.zeros(3), team=SOLO).choose(bodies, 1.0)
    count = ALL_PAIRS_UP_TO + 1
    search_by("grid", np.linspace(0.1, 0.2, count), np.zeros(3)).pairs(np.random.default_rng(0).random((count, 3)))
    Space(scene, threads=1).energy()
    frictionless, open_space = materials_of(pair_coefficients(scene)), np.zeros(3)
    solver = ContactSolver(bodies, half_spaces(scene), frictionless, open_space, friction=True, team=SOLO)
    solver.lay(solver.order)
    solver.speeds_by_pair()
    solver.statistics()
    solver.compile_phases()
    FrameStore(1, bodies).keep()
    with compiling_all():  # kernels that only long runs need come last
        rolling = Scene.from_dict({"title": "", **SCENES["a ball that rolls on"]})
        for _ in Space(rolling, threads=1, record_contacts=True).run():
            pass


def _compile_encoding() -> None:
    """Compile the kernels that write a batch of frames, with an empty batch."""
    position, single, points = np.empty((0, 0, 3)), np.empty((0, 3), np.float32), np.empty((0, 0, 3), np.float32)
    values, each = np.empty(0), np.empty(0, np.int64)
    numbers, bytes_, scale = np.empty(0, np.uint32), np.empty(0, np.uint8), np.empty(0, np.float32)
    rows, strips, box = np.empty(0, CONTACT_ROW), np.empty((0, 6), np.float32), np.zeros(3)
    columns = encoding.EdgeColumns(np.empty((0, 2), np.uint32), scale, scale, bytes_, numbers, scale)
    pairs, counts = np.empty((0, 2), np.int64), np.empty((0, 3), np.int64)
    contacts = encoding.FrameContacts(pairs, np.empty((0, 3)), values, each, rows, rows, counts)
    encoding.write_contacts(contacts, values, numbers, scale, columns)
    encoding.find_middles(contacts, values, values)
    encoding.pick_strongest(rows, each, each, values, each, rows)
    encoding.draw_edges(contacts, points, values, box, palette.STAGE_COLOURS, strips, numbers, np.empty((0, 3)))
    ImpactPlan(everything=False, oriented=True, turned=True).choose(position, each, each, each, values)
    torques = encoding.TorqueList(position, each, numbers, values)
    encoding.draw_arrows(torques, points, values, values, 1.0, encoding.Arrows(single, single))
    encoding.list_torques(torques)
    encoding.cast_orientations(np.empty((0, 0, 4)), np.empty((0, 0, 4), np.float32))
    encoding.cast_positions(position, box, points)


def _compile_second_steps(bodies: Bodies) -> None:
    """Compile the kernels that a run with contacts needs after its first step, with two bodies in contact."""
    pairs, place, ends, none = np.array([[0, 1]]), np.zeros(1, np.int64), len(bodies.ends.velocity), np.zeros(3)
    contacts = np.zeros(1, CONTACT)
    cache = ImpulseCache(pairs, place, contacts, 1.0)
    cache.carry_to(pairs, place, 1.0, contacts, SOLO)
    assert len(cache.impulse) == 1
    unequal = np.arange(3.0 * ends).reshape(ends, 3)
    Islands(ends, SOLO).write_load_speeds(pairs, pairs[0], unequal, np.ones(ends), none, 1.0, np.zeros(1))
    largest_values(unequal, none, bodies.position)
    with_contacts(Ledger(), np.zeros((1, 3)))
    load_helpers()
    refuse_infinities(bodies, ["", ""], 0, 0.0, SI)


def _end_with_parent() -> None:
    sys.stdin.buffer.read()
    os._exit(0)


if __name__ == "__main__":
    threading.Thread(target=_end_with_parent, daemon=True).start()
    collect_garbage_rarely()
    compile_ahead()
    os._exit(0)
