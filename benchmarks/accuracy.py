"""Measures whether runs keep the accuracy that they were asked for, and what that costs.

    python benchmarks/accuracy.py                        # 40 random scenes, and the bundled ones
    python benchmarks/accuracy.py --random 8 --requests 1e-2,1e-6

Each scene runs with each request. The error is the largest rms distance from a reference over the size of the system,
up to the horizon that the run names. The reference is the event-driven one where there is one, otherwise the same scene
with steps four times finer than those of the run, and than 16 times refined ones. The measured horizon is where the
distance exceeds the request. The cost is the CPU time of the run with its look ahead, over that of the cheapest run of
a grid of plain settings that keeps the request as far.
"""

from __future__ import annotations

import argparse
import json
import math
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from carom.experiment.work_precision.event_driven_reference import solve, why_not
from carom.physics.error import PhysicsError
from carom.physics.look_ahead import settled
from carom.physics.periodic_box import minimum_images
from carom.physics.schedule import at
from carom.physics.space import Space
from carom.plan.auto import integrator
from carom.scene.error import SceneError
from carom.scene.load import scene_from_text
from carom.scene.schema import Scene

FloatArray = NDArray[np.float64]

BUNDLED = (
    "kepler-orbits",
    "figure-eight",
    "newtons-cradle",
    "elastic-gas",
    "two-spheres",
    "rack-break",
    "cloud-collapse",
)
REQUESTS = "1e-2,1e-4,1e-6,1e-8,1e-10"
SAMPLES = 64
FINER = 4.0  # times as fine as the run is a reference without an event-driven one
BUDGET = 20.0  # s, of the event-driven reference
PLAIN = (1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0)  # refinements that stand for what `carom tune` would try
FREE = ("fixed_dt", "target_dx", "cfl", "pull_fraction", "smoothing", "velocity_limit", "integrator")


def bundled(name: str) -> Scene:
    """Load a scene without the keys that set its step."""
    scene = Scene.load(name)
    given = scene.time.model_fields_set
    return Scene.load(name, [f"time.{key}=" for key in FREE if key in given])


def random_scene(index: int) -> Scene:
    """Return a random scene: 2 to 200 bodies, with and without contacts, walls, friction, gravity."""
    rng = np.random.default_rng(1000 + index)
    count = round(2.0 * 100.0 ** rng.random())
    kind = index % 4  # free flights in a box, gravity without contacts, gravity with contacts, a field and a floor
    touches = kind != 1
    friction = 0.3 * float(rng.integers(2)) if touches else 0.0
    pulls = kind in (1, 2)
    size = 0.6 + 0.3 * count ** (1.0 / 3.0)
    scene: dict[str, Any] = {
        "title": f"random {index}",
        "seed": index,
        "time": {"duration": float(4.0 + 8.0 * rng.random()), "max_dt": 0.25},
        "gravity": {"constant": 1.0 if pulls else 0.0},
        "contact": {
            "enabled": touches,
            "restitution": float(rng.choice([1.0, 0.9, 0.5])),
            "static_friction": friction,
            "kinetic_friction": friction,
        },
        "group": [
            {
                "count": count,
                "radius": {"min": 0.06, "max": 0.12},
                "mass": 1.0 / count,
                "region": {"shape": "ball", "radius": size},
                "velocity": {"dispersion": float(0.2 + 0.6 * rng.random())},
            }
        ],
    }
    if kind == 0:
        scene["domain"] = {"boundary": "walls", "size": [2.5 * size] * 3}
    if kind == 3:
        scene["gravity"]["uniform"] = [0.0, 0.0, -1.0]
        scene["plane"] = [{"point": [0.0, 0.0, -size - 0.5]}]
    return Scene.from_dict(scene)


def positions(space: Space, times: FloatArray) -> Iterator[FloatArray]:
    """Run up to each time; yield positions, (n, 3) m."""
    for moment in times.tolist():
        for _ in space.run(moment, schedule=at(())):
            pass
        yield space.state.position.copy()


def with_step(scene: Scene, accuracy: float, refinement: float) -> Scene:
    """Return a scene with a given refinement, without a look ahead."""
    promise = f"{{ refinement = {refinement!r}, until = {scene.time.duration!r}, lyapunov = 0.0, error = [0.0] }}"
    return scene_from_text(scene.toml, scene.title, [f"time.accuracy={accuracy!r}", f"promise={promise}"])


def run(scene: Scene, times: FloatArray) -> tuple[FloatArray, float, int]:
    """Run a scene; return positions at times, CPU seconds and steps. Steps do not end at the times but the last."""
    began = time.process_time()
    space = Space(scene, 1)
    found = []
    try:
        found = list(positions(space, times))
    except PhysicsError:
        found += [np.full_like(space.state.position, np.nan)] * (len(times) - len(found))
    return np.array(found), time.process_time() - began, space.step


def apart(scene: Scene, a: FloatArray, b: FloatArray) -> FloatArray:
    """Return the largest rms distance so far over the size, (K,)."""
    k = min(len(a), len(b))
    d = a[:k] - b[:k]
    if scene.domain.boundary == "periodic":
        d = minimum_images(d, np.array(scene.domain.size))
    start = Space(scene, 1).state.position
    size = math.sqrt(float(np.mean(np.sum((start - start.mean(axis=0)) ** 2, axis=1)))) or float(np.abs(start).max())
    if scene.domain.boundary == "periodic" and scene.domain.size:
        size = min(scene.domain.size) / 2.0
    return np.asarray(np.maximum.accumulate(np.sqrt(np.mean(np.sum(d * d, axis=2), axis=1))) / size)


def measure(scene: Scene, requests: list[float]) -> Iterator[dict[str, Any]]:
    """Measure a scene with each request."""
    times = scene.time.duration * np.arange(1, SAMPLES + 1) / SAMPLES
    exact: FloatArray | None = None
    if not why_not(scene):
        exact = solve(Space(scene, 1), times, budget=BUDGET).trajectory.position
        exact = exact if len(exact) > 1 else None
    plain: dict[float, tuple[FloatArray, float, int]] = {}
    for request in requests:
        row: dict[str, Any] = {"scene": scene.title, "bodies": scene.count, "request": request}
        asked = scene_from_text(scene.toml, scene.title, [f"time.accuracy={request!r}"])
        began = time.process_time()
        try:
            found = settled(asked, 1)
        except (SceneError, PhysicsError) as refusal:
            yield row | {"refused": str(refusal)}
            continue
        ahead = time.process_time() - began
        assert found.promise is not None
        kept = found.promise.kept_until
        path, cost, steps = run(found, times)
        reference = exact
        if reference is None:
            finer = 1.0 if integrator(found).controls_error else FINER * max(found.promise.refinement, 16.0)
            reference = run(with_step(scene, request, finer), times)[0]
        error = apart(scene, path, reference)
        inside = times[: len(error)] <= kept
        worst = float(error[inside].max()) if inside.any() else 0.0
        over = np.flatnonzero(error > request)
        measured = float(times[over[0]]) if len(over) else None
        best = cheapest(scene, request, reference, times, kept, plain)
        yield row | {
            "integrator": integrator(found).name,
            "refinement": found.promise.refinement,
            "kept_until": kept / scene.time.duration,
            "measured_horizon": None if measured is None else measured / scene.time.duration,
            "lyapunov": found.promise.lyapunov,
            "error": worst,
            "kept": bool(worst <= request),
            "reference": "exact" if exact is not None else "finer",
            "steps": steps,
            "look_ahead": ahead,
            "run": cost,
            "best": best,
        }


def cheapest(
    scene: Scene,
    request: float,
    reference: FloatArray,
    times: FloatArray,
    kept: float,
    plain: dict[float, tuple[FloatArray, float, int]],
) -> float | None:
    """Return the CPU seconds of the cheapest plain setting of a grid that keeps a request as far; None if none does."""
    costs = []
    for factor in PLAIN:
        if factor not in plain:
            plain[factor] = run(with_step(scene, 1e-2, factor), times)
        path, cost, _ = plain[factor]
        error = apart(scene, path, reference)
        inside = times[: len(error)] <= kept
        if not inside.any() or error[inside].max() <= request:
            costs.append(cost)
    return min(costs, default=None)


def main() -> None:
    """Measure, print a line for each case and the totals, and write the rows."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--random", type=int, default=40)
    parser.add_argument("--scenes", default=",".join(BUNDLED))
    parser.add_argument("--requests", default=REQUESTS)
    parser.add_argument("--json", type=Path, help="file to write the rows to")
    given = parser.parse_args()
    requests = [float(text) for text in given.requests.split(",")]
    scenes = [random_scene(index) for index in range(given.random)]
    scenes += [bundled(name) for name in given.scenes.split(",") if name]
    rows = []
    for scene in scenes:
        for row in measure(scene, requests):
            rows.append(row)
            print({k: f"{v:.3g}" if isinstance(v, float) else v for k, v in row.items()}, flush=True)
            if given.json:
                given.json.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")
    print(summary(rows))


def summary(rows: list[dict[str, Any]]) -> str:
    """Return the totals of all rows."""
    tried = [row for row in rows if "refused" not in row]
    kept = sum(row["kept"] for row in tried)
    whole = sum(row["kept_until"] >= 1.0 for row in tried)
    ratios = [(row["look_ahead"] + row["run"]) / row["best"] for row in tried if row["best"]]
    ends = [row for row in tried if row["kept_until"] < 1.0 and row["measured_horizon"]]
    near = sum(abs(row["kept_until"] / row["measured_horizon"] - 1.0) <= 0.2 for row in ends)
    return (
        f"{len(tried)} cases: {kept} within the request up to the horizon ({kept / max(len(tried), 1):.1%}), "
        f"{whole} to the end; cost over the best: median {np.median(ratios) if ratios else math.nan:.2f}, "
        f"at most 1.5 in {sum(r <= 1.5 for r in ratios)} of {len(ratios)}; horizon within 20 % in {near} of {len(ends)}"
    )


if __name__ == "__main__":
    main()
