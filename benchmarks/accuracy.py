"""Measures whether runs keep the requested accuracy, for how long, and at what cost.

    python benchmarks/accuracy.py                        # 40 random scenes and those of docs/trade.md; goes on where it
    python benchmarks/accuracy.py --random 8 --scenes figure-eight --requests 1e-2,1e-6       # was interrupted
    python benchmarks/accuracy.py --table                # the table of docs/validation.md, from the rows so far

Each scene runs with each request, on one thread. The error is the largest rms distance from a reference over the size
of the system, up to the horizon that the run states. The reference comes from `impact_reference`, which uses nothing of
carom's physics. It ends where bodies come to rest. From there on, the reference is a run with four times finer steps,
also for the settings. The measured horizon is the time at which the distance exceeds the request.

The cost is the CPU time of the run with its look-ahead, over that of the cheapest plain setting that keeps the request
for as long. Plain settings are those among which `carom tune` searches: integrators, and steps that differ by factors
of two, with impacts at their own times. Steps are halved until they keep the request or cost more than the run.
"""

from __future__ import annotations

import argparse
import json
import math
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from carom.errors import PhysicsError, SceneError
from carom.lab.tradeoff.settings_grid import GridPoint, knobs
from carom.physics.look_ahead.find_step import with_promise
from carom.physics.schedule import at, every
from carom.physics.space import Space
from carom.physics.vector import minimum_images
from carom.plan.auto import integrator
from carom.scene.integrators import INTEGRATORS
from carom.scene.load import Scene, scene_from_text
from impact_reference import Solution, solve

FloatArray = NDArray[np.float64]

ROOT = Path(__file__).parent
RESULTS = ROOT / "results" / "accuracy.json"
TRADE = (
    "figure-eight",
    "kepler-orbits",
    "newtons-cradle",
    "scenes/pythagorean.toml",
    "scenes/planetary-system.toml",
    "scenes/eccentric-triple.toml",
    "elastic-gas",
    "cloud-collapse",
    "rubble-collision",
    "scenes/star-cluster.toml",
)
REQUESTS = "1e-2,1e-4,1e-6,1e-8,1e-10"
SAMPLES = 64
FINER = 4.0  # ratio of the steps of a run to those of its reference after bodies have come to rest
BUDGET = 60.0  # s of computing for a reference
LONGEST_RUN = 6.0  # s of computing; of a longer run, the part computed by then is compared
COARSEST, FINEST = 4.0, 2.0**-12  # factors on the step of the settings
REPEATED_BELOW = 0.1  # s, runs that are timed three times
FRAMES = 600  # of a recording; a setting that records fewer of the run's frames is left out, as by `carom tune`
FEWEST_FRAMES = 0.95
FREE = ("fixed_dt", "target_dx", "cfl", "pull_fraction", "smoothing", "velocity_limit", "integrator")
TIMING = "contact.timing"
INTEGRATOR = "time.integrator"


def bundled(name: str) -> Scene:
    """Load a scene without the keys that set its step, and with impacts at their own times."""
    where = str(ROOT / name) if name.endswith(".toml") else name
    scene = Scene.load(where)
    given = scene.time.model_fields_set
    late = ["contact.timing="] if "timing" in scene.contact.model_fields_set else []
    return Scene.load(where, [f"time.{key}=" for key in FREE if key in given] + late)


def random_scene(index: int) -> Scene:
    """Return a random scene: 2 to 200 bodies, with and without contacts, walls, friction, gravity."""
    rng = np.random.default_rng(1000 + index)
    count = round(2.0 * 100.0 ** rng.random())
    kind = index % 4  # free flights in a box, gravity without contacts, gravity with contacts, a field and a floor
    touches = kind != 1
    friction = 0.3 * float(rng.integers(2)) if touches else 0.0
    size = (0.3 + 0.2 * count ** (1.0 / 3.0)) * float(1.0 + rng.random())  # m; spheres fill up to 8 % of the ball
    scene: dict[str, Any] = {
        "title": f"random {index}",
        "seed": index,
        "time": {"duration": float(4.0 + 8.0 * rng.random()), "max_dt": 0.25},
        "gravity": {"constant": 1.0 if kind in (1, 2) else 0.0},
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
    if kind == 0 or (kind == 2 and index % 8 == 2):
        scene["domain"] = {"boundary": "walls", "size": [2.5 * size] * 3}
    if kind == 3:
        scene["gravity"]["uniform"] = [0.0, 0.0, -1.0]
        scene["plane"] = [{"point": [0.0, 0.0, -size - 0.5]}]
    return Scene.from_dict(scene)


def with_step(scene: Scene, refinement: float) -> Scene:
    """Return a settled scene with another refinement."""
    return scene_from_text(scene.toml, scene.title, [f"promise.refinement={refinement!r}"])


class Run(NamedTuple):
    """A run as far as it came."""

    path: FloatArray  # (K, n, 3) m
    cost: float  # s of CPU time, with its preparations
    steps: int


def follow(scene: Scene, times: FloatArray) -> Run:
    """Run a scene to as many of the times as it reaches; a step ends at each of them."""
    began, steps = time.process_time(), 0
    found: list[FloatArray] = []
    try:
        space = Space(scene, 1)
        for moment in times.tolist():
            for _ in space.run(moment, schedule=every(scene.time.duration / SAMPLES)):
                if time.process_time() - began > LONGEST_RUN:
                    return Run(np.array(found), time.process_time() - began, space.step)
            found.append(space.state.position.copy())
        steps = space.step
    except PhysicsError:
        pass
    spent = time.process_time() - began
    if spent < REPEATED_BELOW and len(found) == len(times):
        spent = least(lambda: run_freely(scene))
        steps = run_freely(scene)
    return Run(np.array(found), spent, steps)


def run_freely(scene: Scene) -> int:
    """Run a scene to its end; return its number of steps."""
    space = Space(scene, 1)
    for _ in space.run(schedule=at(())):
        pass
    return space.step


def least(act: Callable[[], Any]) -> float:
    """Return the CPU time of a call in s; of a short one, the least of three."""
    spent = math.inf
    for _ in range(3):
        began = time.process_time()
        act()
        spent = min(spent, time.process_time() - began)
        if spent > REPEATED_BELOW:
            break
    return spent


@dataclass
class Case:
    """A scene, its reference, and the results of plain settings so far."""

    scene: Scene
    times: FloatArray
    size: float  # m
    reference: Solution
    plain: dict[GridPoint, Run] = field(default_factory=dict)

    @classmethod
    def of(cls, scene: Scene) -> Case:
        """Solve a scene for its reference."""
        times = scene.time.duration * np.arange(1, SAMPLES + 1) / SAMPLES
        start = Space(scene, 1).state.position
        size = math.sqrt(float(np.mean(np.sum((start - start.mean(axis=0)) ** 2, axis=1)))) or float(
            np.abs(start).max()
        )
        return cls(scene, times, size, solve(scene, times, BUDGET))

    def apart(self, a: FloatArray, b: FloatArray) -> FloatArray:
        """Return the running maximum of the rms distance over the size, up to the end of the shorter path."""
        k = min(len(a), len(b))
        if k == 0:
            return np.zeros(0)
        d = a[:k] - b[:k]
        if self.scene.domain.boundary == "periodic":
            d = minimum_images(d, np.array(self.scene.domain.size))
        return np.asarray(np.maximum.accumulate(np.sqrt(np.mean(np.sum(d * d, axis=2), axis=1))) / self.size)

    def measure(self, request: float) -> dict[str, Any]:
        """Run with a request, and compare the run with the reference."""
        scene, solved = self.scene, len(self.reference.position)
        row: dict[str, Any] = {"scene": scene.title, "bodies": scene.count, "request": request}
        asked = scene_from_text(scene.toml, scene.title, [f"time.accuracy={request!r}"])
        try:
            began = time.process_time()
            found = with_promise(asked, 1)
            ahead = time.process_time() - began
        except (SceneError, PhysicsError) as refusal:
            return row | {"refused": str(refusal)}
        if ahead < 10.0 * REPEATED_BELOW:  # the first one of a process loads kernels
            ahead = least(lambda: with_promise(asked, 1))
        assert found.promise is not None
        kept = found.promise.kept_until
        path, own, steps = follow(found, self.times)
        cost = least(lambda: run_freely(asked)) if own < REPEATED_BELOW else ahead + own
        reference = self.reference.position
        until = self.times[min(solved, len(path)) - 1] if solved else 0.0
        error = self.apart(path, reference)
        finer = kept > until and solved < SAMPLES
        if finer:
            beyond = follow(with_step(found, FINER * found.promise.refinement), self.times).path
            longer = self.apart(path, beyond)
            error = np.maximum.accumulate(np.concatenate((error, longer[len(error) :])))
            reference = np.concatenate((reference, beyond[len(reference) :]))
        inside = self.times[: len(error)] <= kept
        worst = float(error[inside].max()) if inside.any() else 0.0
        over = np.flatnonzero(error > request)
        ends = self.times[over[0]] if len(over) else self.times[len(error) - 1] if len(error) else 0.0
        return row | {
            "integrator": integrator(found).name,
            "refinement": found.promise.refinement,
            "kept_until": kept / scene.time.duration,
            "measured_horizon": float(ends) / scene.time.duration,
            "exceeded": bool(len(over)),
            "reference": solved / SAMPLES,
            "reference_ended": self.reference.ended,
            "impacts": int(np.sum(np.array(self.reference.impacts) <= kept)),
            "lyapunov": found.promise.lyapunov,
            "error": worst,
            "kept": bool(worst <= request),
            "steps": steps,
            "look_ahead": ahead,
            "cost": cost,
            "best": self.cheapest(request, reference, kept, cost, min(FRAMES, steps)),
        }

    def cheapest(
        self, request: float, reference: FloatArray, kept: float, most: float, frames: int
    ) -> dict[str, Any] | None:
        """Return the cheapest plain setting, up to a cost, that keeps a request and frames as long, or None."""
        best: tuple[float, GridPoint] | None = None
        for name in self.integrators():
            step = COARSEST
            while step >= FINEST:
                point = GridPoint(step).having(INTEGRATOR, name)
                if self.scene.contact.enabled:
                    point = point.having(TIMING, "time-of-impact")
                try:
                    path, spent, steps = self.plain_run(point)
                except (SceneError, PhysicsError):
                    break
                error = self.apart(path, reference)
                inside = self.times[: len(error)] <= kept
                far = len(error) > 0 and (len(error) == len(reference) or self.times[len(error) - 1] >= kept)
                enough = min(FRAMES, steps) >= FEWEST_FRAMES * frames
                keeps = far and enough and (not inside.any() or error[inside].max() <= request)
                if keeps and (best is None or spent < best[0]):
                    best = spent, point
                if keeps or spent > min(most, best[0] if best else math.inf) or INTEGRATORS[name].controls_error:
                    break
                step /= 2.0
        return None if best is None else {"cost": best[0], "setting": best[1].setting(self.scene).name}

    def integrators(self) -> list[str]:
        """Name the integrators of the search, without euler, which is never cheaper than leapfrog."""
        own, others = integrator(self.scene).name, knobs(self.scene).get(INTEGRATOR, ())
        radau = ("gauss-radau15",) if self.scene.count <= 1000 else ()
        return [
            name for name in dict.fromkeys((own, "leapfrog", *others, *radau)) if name not in ("euler", "leapfrog-dkd")
        ]

    def plain_run(self, point: GridPoint) -> Run:
        """Run a plain setting, once."""
        if point not in self.plain:
            self.plain[point] = follow(point.setting(self.scene).apply(self.scene), self.times)
        return self.plain[point]


def main() -> None:
    """Measure the missing rows, write all rows, and print the totals."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--random", type=int, default=40)
    parser.add_argument("--only", type=lambda text: [int(each) for each in text.split(",")], help="these random scenes")
    parser.add_argument("--scenes", default=",".join(TRADE))
    parser.add_argument("--requests", default=REQUESTS)
    parser.add_argument("--table", action="store_true", help="print the table of the rows so far")
    parser.add_argument(
        "--json", type=Path, default=RESULTS, help="file of the rows; those in it are not measured again"
    )
    given = parser.parse_args()
    rows: list[dict[str, Any]] = json.loads(given.json.read_text(encoding="utf-8")) if given.json.exists() else []
    if given.table:
        print(table(rows))
        return
    requests = [float(text) for text in given.requests.split(",")]
    known = {(row["scene"], row["request"]) for row in rows}
    for scene in scenes(given.only or list(range(given.random)), [name for name in given.scenes.split(",") if name]):
        missing = [request for request in requests if (scene.title, request) not in known]
        if not missing:
            continue
        case = Case.of(scene)
        for request in missing:
            rows.append(case.measure(request))
            print({k: f"{v:.3g}" if isinstance(v, float) else v for k, v in rows[-1].items()}, flush=True)
            given.json.write_text("[\n" + ",\n".join(map(json.dumps, rows)) + "\n]\n", encoding="utf-8")
    print(table(rows))


def scenes(random: list[int], names: list[str]) -> Iterator[Scene]:
    """Return the random scenes, then those of docs/trade.md."""
    yield from map(random_scene, random)
    yield from map(bundled, names)


def table(rows: list[dict[str, Any]]) -> str:
    """Return the totals of each request, and of all, as a table."""
    requests = sorted({row["request"] for row in rows}, reverse=True)
    lines = [
        "| request | cases | refused | kept | to the end | horizon within 20 % | cost over the best | at most 1.5 |",
        "|---|---|---|---|---|---|---|---|",
        *(_line(f"{request:g}", [row for row in rows if row["request"] == request]) for request in requests),
        _line("all", rows),
    ]
    return "\n".join(lines)


def _line(name: str, rows: list[dict[str, Any]]) -> str:
    tried = [row for row in rows if "refused" not in row]
    kept, whole = sum(row["kept"] for row in tried), [row for row in tried if row["kept_until"] >= 1.0]
    ends = [row for row in tried if row["kept_until"] < 1.0 or row["exceeded"]]
    near = sum(abs(row["kept_until"] / row["measured_horizon"] - 1.0) <= 0.2 for row in ends if row["measured_horizon"])
    ratios = [row["cost"] / row["best"]["cost"] for row in tried if row["best"]]
    cheap = sum(ratio <= 1.5 for ratio in ratios) + len(tried) - len(ratios)  # no setting keeps it as far at that cost
    median = f"{np.median(ratios):.2f}" if ratios else "–"
    share = f"{kept} ({kept / max(len(tried), 1):.0%})"
    return (
        f"| {name} | {len(tried)} | {len(rows) - len(tried)} | {share} | {len(whole)} | {near} of {len(ends)} "
        f"| {median} | {cheap} |"
    )


if __name__ == "__main__":
    main()
