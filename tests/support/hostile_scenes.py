"""Scenes that nobody should write, drawn at random: every key, with values at both ends of what a number can be.

    python hostile_scenes.py SEED FIRST COUNT

judges so many of them, each a line of JSON: how it ended, and what is wrong with that, if anything.
"""

from __future__ import annotations

import json
import random
import resource
import sys
import time
from typing import Any

import numpy as np

from carom.errors import PhysicsError, SceneError
from carom.physics.space import Space
from carom.plan.checks import refuse_impossible
from carom.runs.warmup import warm_up
from carom.scene.integrators import AUTO, INTEGRATORS
from carom.scene.load import Scene, scene_from_text
from carom.scene.scene_file import bundled_scenes

MEMORY = 3 * 2**30  # bytes that the process may take besides what it has when it begins
SLOWEST = 60  # s of CPU for one scene, after which its process ends; the slowest seen took 10
STEPS = 12
PATIENCE = 2.0  # s of steps; a scene of many bodies makes fewer
Document = dict[str, Any]

ORDINARY = (0.1, 0.5, 1.0, 2.0, 3.0, 10.0)
EXTREME = (
    5e-324,
    1e-310,
    1e-200,
    1e-155,
    1e-30,
    1e-9,
    1e-3,
    1e3,
    1e6,
    1e9,
    1e16,
    1e20,
    1e75,
    1e103,
    1e154,
    1e200,
    1e308,
)


def document(rng: random.Random) -> Document:
    """Draw a scene. Each has a few extremes, not all: else every one would be refused for the first."""
    daring = rng.choice((0.0, 0.03, 0.1, 0.3))

    def number(signed: bool = False, usual: tuple[float, ...] = ORDINARY) -> Any:
        value = rng.choice(EXTREME) * rng.choice((1.0, 1.5)) if rng.random() < daring else rng.choice(usual)
        if rng.random() < 0.01 * (daring > 0):
            return rng.choice((0, -1.0, float("inf"), float("nan"), 10**400, -(2**63), True, "1", [], {}))
        return rng.choice((-1, 1)) * value if signed else value

    def vector(signed: bool = True, usual: tuple[float, ...] = (0.0, *ORDINARY)) -> Any:
        return [number(signed, usual) for _ in range(3)]

    def some(section: Document, chance: float = 0.5) -> Document:
        return {key: value() for key, value in section.items() if rng.random() < chance}

    def matter() -> Document:
        return some({rng.choice(("mass", "density")): number, "inertia_factor": lambda: rng.choice((0.4, 1e-9, 2 / 3))})

    def group() -> Document:
        low, high = sorted(rng.choices(ORDINARY[:5] + EXTREME if daring else ORDINARY[:5], k=2))
        radius = rng.choice((number(), {"min": low, "max": high} | some(distribution)))
        region = rng.choice(
            ({"radius": number(usual=(10.0, 30.0))}, {"shape": "box", "size": vector(False, (10.0, 30.0))})
        )
        if rng.random() < 0.5:
            region["centre"] = vector()
        keys = {
            "region": lambda: region,
            "velocity": lambda: some({"mean": vector, "dispersion": number}),
            "spin": lambda: some({"dispersion": number}),
            "bulk_rotation": vector,
        }
        count = rng.choice((1, 2, 5, 20, 20, 20, 300, 300, 20_000, 10**12) if daring else (1, 5, 20))
        return {"count": count, "radius": radius} | matter() | some(keys)

    def body() -> Document:
        keys = {
            "position": lambda: vector(usual=(0.0, 2.0, 4.0, 6.0)),
            "velocity": vector,
            "angular_velocity": vector,
            "radius": lambda: number(usual=(0.5, 1.0)),
        }
        return matter() | (some(keys, 0.8) if rng.random() < 0.9 else {"fixed": True})

    distribution = {
        "distribution": lambda: rng.choice(("uniform", "log-uniform", "power-law")),
        "exponent": lambda: rng.choice((-3.5, -1.0, 0.0, number(True))),
    }
    time_keys = {
        "duration": number,
        "max_dt": number,
        "target_dx": lambda: rng.choice(("auto", number())),
        "cfl": lambda: rng.choice(("auto", number())),
        "smoothing": lambda: rng.choice((1.0, 0.2, 1e-90)),
        "velocity_limit": lambda: rng.choice(("every-body", "fastest-body")),
        "fixed_dt": lambda: number(usual=(1e-3, 1e-2, 0.1)),
        "integrator": lambda: rng.choice((AUTO, *INTEGRATORS)),
    }
    gravity = {
        "constant": lambda: rng.choice((0.0, 0.0, 1.0, number())),
        "method": lambda: rng.choice(("auto", "direct", "tree", "none")),
        "opening_angle": lambda: rng.choice((0.5, 1e-90, 1.0)),
        "quadrupoles": lambda: rng.random() < 0.5,
        "softening": lambda: rng.choice((0.0, number())),
        "uniform": lambda: rng.choice(([0.0, 0.0, 0.0], [0.0, 0.0, -9.81], vector())),
    }
    contact = {
        "enabled": lambda: rng.random() < 0.9,
        "restitution": lambda: rng.choice((0.0, 0.5, 1.0, number())),
        "static_friction": lambda: rng.choice((0.0, number())),
        "solver": lambda: rng.choice(("lasting", "staged")),
        "colouring": lambda: rng.choice(("contacts", "bodies")),
        "stabilisation": lambda: rng.choice(("split", "baumgarte", "none")),
        "timing": lambda: rng.choice(("auto", "end-of-step", "time-of-impact")),
        "search": lambda: rng.choice(("grid", "k-d-tree")),
        "sweeps": lambda: rng.choice((1, 8, 40)),
        "allow_overlap": lambda: rng.random() < 0.5,
    }
    scene: Document = {
        "seed": rng.choice((0, 1, 2**31, 2**63 - 1, 2**63)) if daring else rng.randrange(100),
        "time": some(time_keys, 0.3),
        "gravity": some(gravity),
        "contact": some(contact, 0.3),
        "record": some(
            {"check_every": lambda: rng.choice((1, 10)), "every": lambda: rng.choice(("step", number()))}, 0.2
        ),
    }
    boundary = rng.choice(("open", "open", "periodic", "periodic", "walls"))
    if boundary != "open":
        scene["domain"] = {"boundary": boundary, "size": vector(False, (20.0, 30.0, 60.0))}
    if boundary == "periodic":
        scene["gravity"] = {"constant": 0.0}
    elif rng.random() < 0.3:
        plane = {"point": lambda: [0.0, 0.0, number(usual=(-10.0,))], "normal": vector, "restitution": number}
        scene["plane"] = [some(plane) for _ in range(rng.choice((1, 1, 2, 4)))]
    if rng.random() < 0.5:
        scene["group"] = [group() for _ in range(rng.choice((1, 1, 2)))]
    if rng.random() < 0.6 or "group" not in scene:
        scene["body"] = [body() for _ in range(rng.choice((1, 2, 3, 6)))]
    if boundary == "walls" and rng.random() < 0.5:
        _put_at_walls(rng, scene)
    return scene


def _put_at_walls(rng: random.Random, scene: Document) -> None:
    """Move bodies to the walls, where most of them overlap something at the start."""
    scene["contact"] |= {"allow_overlap": True}
    for body in scene.get("body", []):
        inside = rng.choice((1.0, 1.0 - 1e-15, 1.0 - 1e-9, 0.999, 0.9))
        body["position"] = [
            rng.choice((-0.5, 0.0, 0.5)) * inside * side if isinstance(side, float) else 0.0
            for side in scene["domain"]["size"]
        ]


def damaged_text(rng: random.Random) -> str:
    """Take a bundled scene and damage its text."""
    text = rng.choice(list(bundled_scenes().values())).read_text(encoding="utf-8")
    pieces = [
        "[",
        "]",
        "{",
        "}",
        "=",
        ".",
        '"',
        "'",
        "\n",
        "#",
        ",",
        "-",
        "e",
        "9" * 400,
        "inf",
        "\0",
        "[[",
        "\\u00",
        " ",
    ]
    for _ in range(rng.choice((1, 1, 2, 5, 20))):
        at, length = rng.randrange(len(text)), rng.choice((0, 1, 1, 5, 50))
        text = text[:at] + rng.choice((rng.choice(pieces), "")) + text[at + length :]
    return text


def faults_of(scene: Scene) -> list[str]:
    """Run a scene for a few steps; tell what of the outcome is wrong."""
    refuse_impossible(scene)
    each_step = scene.record.model_copy(update={"every": "step"})
    space = Space(scene.model_copy(update={"record": each_step}), threads=1)
    began = time.monotonic()
    faults: set[str] = set()
    half = 0.5 * np.array(scene.domain.size) if scene.domain.boundary == "walls" else np.full(3, np.inf)
    began_inside = np.flatnonzero((np.abs(space.state.position) <= half).all(axis=1))
    if len(began_inside) < len(space.state) and not scene.contact.allow_overlap:
        faults.add("a body that begins behind a wall")
    for step, frame in enumerate(space.run()):
        state = space.state
        if not all(np.isfinite(array).all() for array in (state.position, state.velocity, state.angular_velocity)):
            faults.add("a state that is not finite")
        numbers = [frame.energy.total, frame.energy.integration_error, *space.momentum(), *space.angular_momentum()]
        if not np.isfinite(numbers).all():
            faults.add("energy or momentum that is not finite")
        if space.box is not None and not (np.abs(state.position) <= 0.5 * space.box * (1 + 1e-9)).all():
            faults.add("a body outside its periodic box")
        if scene.contact.enabled and (np.abs(state.position[began_inside]) > half).any():
            faults.add("a body through a wall")
        if step >= STEPS or time.monotonic() - began > PATIENCE:
            break
    return sorted(faults)


def drawn(seed: int, index: int) -> Document | str:
    """Draw a scene: a document, or the damaged text of one."""
    rng = random.Random(f"{seed} {index}")
    return damaged_text(rng) if rng.random() < 0.2 else document(rng)


def judge(seed: int, index: int) -> Document:
    """Draw a scene, run it and judge what came of it."""
    scene = drawn(seed, index)
    began = time.monotonic()
    answer: Document = {"index": index, "faults": []}
    try:
        if isinstance(scene, str):
            scene_from_text(scene, "damaged")
            answer["ended"] = "read"
        else:
            answer["faults"] = faults_of(Scene.from_dict(scene))
            answer["ended"] = "ran"
    except (SceneError, PhysicsError) as error:
        answer["ended"] = type(error).__name__
        answer["said"] = str(error)
        if "pydantic" in str(error) or not str(error):
            answer["faults"] = ["a message for nobody"]
    except Exception as error:
        answer["ended"] = "traceback"
        answer["faults"] = [f"{type(error).__name__}: {error}"[:300]]
    answer["seconds"] = round(time.monotonic() - began, 2)
    return answer


def main(seed: int, first: int, count: int) -> None:
    """Judge so many scenes."""
    warm_up()  # no scene has to wait for a compiler
    with open("/proc/self/statm", encoding="ascii") as sizes:  # noqa: PTH123
        taken = int(sizes.read().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (taken + MEMORY, taken + MEMORY))
    for index in range(first, first + count):
        print(json.dumps({"begun": index}), flush=True)  # noqa: T201
        used = resource.getrusage(resource.RUSAGE_SELF)
        resource.setrlimit(resource.RLIMIT_CPU, (int(used.ru_utime + used.ru_stime) + SLOWEST, resource.RLIM_INFINITY))
        print(json.dumps(judge(seed, index)), flush=True)  # noqa: T201


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
