"""Steps of few bodies in contact, in carom and in MuJoCo, on one thread.

    python benchmarks/few_contacts.py [--rounds 9] [--save]

Three balls of which two touch at rest, a ball that slides on a table, and a ball that falls in a viscous medium. carom
takes all steps in one kernel; `single` takes them one by one, as shorter runs do. MuJoCo has no attraction between
bodies: its two touching balls press on each other because of their initial overlap, for as long as the soft contact
lasts. Its medium acts on the ball as on a box, with other coefficients. The sliding ball is fast enough to slide until
the end.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from typing import Any

import mujoco

from carom.physics.jit.decorators import compiling_all
from carom.physics.schedule import at
from carom.physics.space import Space
from carom.scene.load import Scene
from measurement import medians, save

DT, STEPS, SINGLE = 1e-3, 2000, 200
RADIUS = 0.5  # m
FALL = 9.81  # m/s²
TABLE = {
    "plane": [{"point": [0.0, 0.0, 0.0]}],
    "contact": {"restitution": 0.3, "static_friction": 0.6, "kinetic_friction": 0.4},
}
FALLING = {"constant": 0.0, "uniform": [0.0, 0.0, -FALL]}
BALL = {"mass": 1.0, "radius": RADIUS}
ON_TABLE = {**BALL, "position": [0.0, 0.0, RADIUS], "velocity": [50.0, 0.5, 0.0]}
ROW = [{**BALL, "position": [x, y, 0.0]} for x, y in ((0.0, 0.0), (1.0, 0.0), (0.0, 5.0))]
SCENES: dict[str, dict[str, Any]] = {
    "three balls, two touching": {"body": ROW, "gravity": {"constant": 1e-3}},
    "a sliding ball": {"body": [ON_TABLE], "gravity": FALLING, **TABLE},
    "a ball in drag": {
        "body": [{**BALL, "position": [0.0, 0.0, RADIUS]}],
        "gravity": FALLING,
        "drag": {"relaxation_time": 2.0},
    },
}


def in_carom(scene: dict[str, Any], steps: int, single: bool = False) -> Callable[[], object]:
    """Return a function that takes steps of a scene, in one kernel or one by one."""
    settings = {"time": {"duration": 1e6, "fixed_dt": DT}, "record": {"check_every": 1_000_000}}
    space = Space(Scene.from_dict({**settings, **scene}), threads=1)

    def take() -> None:
        if single:
            for _ in range(steps):
                space.compute_dynamics(space.step + 1)
            return
        for _ in space.run(until=space.time + steps * DT, schedule=at(())):
            pass

    return take


def in_mujoco(scene: dict[str, Any]) -> Callable[[], object]:
    """Return a function that takes as many steps of MuJoCo, in nearly the same scene."""
    down = -scene["gravity"].get("uniform", [0.0, 0.0, 0.0])[2]
    medium = 'density="1.2" viscosity="0.05"' if "drag" in scene else ""
    balls = "".join(
        f'<body pos="{x} {y} {z}"><freejoint/><geom type="sphere" size="{RADIUS}" mass="1"/></body>'
        for x, y, z in (body["position"] for body in scene["body"])
    )
    floor = '<geom type="plane" size="0 0 1"/>' if "plane" in scene else ""
    model = mujoco.MjModel.from_xml_string(
        f'<mujoco><option timestep="{DT}" gravity="0 0 {-down}" {medium}/>'
        f'<default><geom condim="3" friction="0.4 0 0"/></default><worldbody>{floor}{balls}</worldbody></mujoco>'
    )
    data = mujoco.MjData(model)
    data.qvel.reshape(-1, 6)[:, :3] = [body.get("velocity", [0.0, 0.0, 0.0]) for body in scene["body"]]
    return lambda: mujoco.mj_step(model, data, nstep=STEPS)


def compare(rounds: int) -> list[dict[str, Any]]:
    """Return the time of a step in µs, for each scene and each contender."""
    rows = []
    for name, scene in SCENES.items():
        with compiling_all():  # otherwise the kernel is compiled for longer runs only
            kernel, single = in_carom(scene, STEPS), in_carom(scene, SINGLE, single=True)
            times = medians({"carom": kernel, "carom, single": single, "MuJoCo": in_mujoco(scene)}, rounds, cold=2)
        taken = {"carom": STEPS, "carom, single": SINGLE, "MuJoCo": STEPS}
        rows.append({"scene": name, "µs": {way: float(f"{1e6 * times[way] / taken[way]:.3g}") for way in taken}})
        print(rows[-1], flush=True)
    return rows


def main() -> None:
    """Measure, print and save."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=9)
    parser.add_argument("--save", action="store_true")
    asked = parser.parse_args()
    rows = compare(asked.rounds)
    if asked.save:
        print(save("few_contacts", {"steps": rows}, "mujoco"))


if __name__ == "__main__":
    main()
