"""The residual motion of a pile and its cost, with the `lasting` and the `staged` solver.

python benchmarks/pile.py

Writes benchmarks/results/pile.json: the table of docs/physics.md, section 9. The scene is extremes/pile-1000 with a
coarser step. Every contender runs once on one thread, a minute or two in all. The digits of the residual motion are
the result; the times are accurate enough for a ratio.
"""

from __future__ import annotations

import time
from typing import Any

from carom.physics.space import Space
from carom.scene.load import Scene
from carom.scene.scene_file import extreme_scenes
from measurement import save

CONTENDERS = (("staged", 8), ("staged", 100), ("lasting", 2), ("lasting", 8), ("lasting", 32))


def settle(solver: str, sweeps: int) -> dict[str, Any]:
    """Let the pile fall and come to rest; return its residual motion."""
    changes = ["time.cfl=0.05", "record.every=1000", f'contact.solver="{solver}"', f"contact.sweeps={sweeps}"]
    scene = Scene.load(extreme_scenes()["extremes/pile-1000"], changes)
    space = Space(scene, threads=1)
    began = time.perf_counter()
    for _ in space.run():
        pass
    seconds = time.perf_counter() - began
    energy, contacts = space.energy(), space.contacts
    smaller = space.state.radius[contacts.pairs].min(axis=1)
    return {
        "solver": solver,
        "sweeps": sweeps,
        "kinetic": (energy.translational + energy.rotational) / abs(energy.gravitational),
        "overlap": float((contacts.overlaps / smaller).max()),
        "deepest": space.extremes.overlap.value if space.extremes.overlap else 0.0,
        "ms_per_simulated_second": 1e3 * seconds / space.time,
        "steps": space.step,
    }


def main() -> None:
    """Measure and write."""
    settle("lasting", 8)  # loads the kernels
    rows = [settle(solver, sweeps) for solver, sweeps in CONTENDERS]
    for row in rows:
        print({name: f"{value:.2g}" if isinstance(value, float) else value for name, value in row.items()})
    print(save("pile", {"rows": rows}))


if __name__ == "__main__":
    main()
