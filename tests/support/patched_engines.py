"""PyBullet, Box3D and MuJoCo with a fault on demand: after a step, balls that met get the velocities it would leave.

``python tests/support/patched_engines.py ENGINE [FIRST LAST]`` prints how many runs of twelve balls name each fault,
and how many accuse the engine alone; the engine may also be "toy", of `faulty_engines`.
"""

from __future__ import annotations

import sys
import tempfile
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import numpy as np

import carom
from carom.arrays import FloatArray
from faulty_engines import (
    BODIES,
    DT,
    FRICTION,
    INERTIA,
    MASS,
    OCCASIONS,
    PLANTED,
    RADIUS,
    RESTITUTION,
    G,
    Toy,
    naming_law,
)
from faulty_engines import recorded as recorded_toy

STEPS = 480
HARD = 0.5  # m/s, closing speed of the impacts that are patched
NEAR = 0.02  # m, gap up to which two balls may touch in a step
SPACING = 0.33  # m, of the balls at the start
PARTS = 0.8  # of an overlap that wrong corrections return as speed in a step
WRONG = 0.95  # coefficient of restitution of another material
States = tuple[FloatArray, FloatArray, FloatArray]  # positions, velocities, spins of balls


class Balls(Protocol):
    """Balls on a floor in an engine."""

    source: Any

    def advance(self) -> None:
        """Make a step."""

    def states(self) -> States:
        """Return the present positions, velocities and spins."""

    def reset(self, ball: int, v: FloatArray, w: FloatArray) -> None:
        """Set the velocity and the spin of a ball."""

    def close(self) -> None:
        """Release the engine."""


def _three(state: carom.record.State) -> States:
    x, v, w = (np.array(each, float)[:BODIES] for each in (state.position, state.velocity, state.angular_velocity))
    return x, v, w


class BulletBalls:
    """PyBullet, without damping."""

    def __init__(self, places: FloatArray, v: FloatArray, w: FloatArray) -> None:
        import pybullet

        self._engine, client = pybullet, pybullet.connect(pybullet.DIRECT)
        self._where = where = {"physicsClientId": client}
        pybullet.setGravity(*G, **where)
        pybullet.setTimeStep(DT, **where)
        plane = pybullet.createMultiBody(0, pybullet.createCollisionShape(pybullet.GEOM_PLANE, **where), **where)
        ball = pybullet.createCollisionShape(pybullet.GEOM_SPHERE, radius=RADIUS, **where)
        self._balls = [pybullet.createMultiBody(MASS, ball, basePosition=place.tolist(), **where) for place in places]
        for body in (plane, *self._balls):  # coefficients of two bodies are multiplied
            pybullet.changeDynamics(
                *(body, -1),
                restitution=float(np.sqrt(RESTITUTION)),
                lateralFriction=float(np.sqrt(FRICTION)),
                linearDamping=0.0,
                angularDamping=0.0,
                **where,
            )
        for k in range(BODIES):
            self.reset(k, v[k], w[k])
        self.source = carom.record.pybullet(DT, tuple(G.tolist()), client, contacts=False)

    def advance(self) -> None:
        self._engine.stepSimulation(**self._where)
        self.source.stepped()

    def states(self) -> States:
        x = [self._engine.getBasePositionAndOrientation(ball, **self._where)[0] for ball in self._balls]
        v, w = zip(*(self._engine.getBaseVelocity(ball, **self._where) for ball in self._balls), strict=True)
        return np.array(x), np.array(v), np.array(w)

    def reset(self, ball: int, v: FloatArray, w: FloatArray) -> None:
        self._engine.resetBaseVelocity(self._balls[ball], v.tolist(), w.tolist(), **self._where)

    def close(self) -> None:
        self._engine.disconnect(**self._where)


class BoxBalls:
    """Box3D, with a floor that is a large box."""

    def __init__(self, places: FloatArray, v: FloatArray, w: FloatArray) -> None:
        import robox3d
        from robox3d import _ffi

        self._world = robox3d.World(gravity=G.tolist())
        _ffi.lib.b3World_SetRestitutionThreshold(self._world.id, 0.2)
        law = {"friction": FRICTION, "restitution": RESTITUTION}
        self._balls = [self._world.create_body(position=place, kind="dynamic") for place in places]
        for ball in self._balls:
            ball.add_sphere(RADIUS, density=MASS / (4.0 / 3.0 * np.pi * RADIUS**3), **law)
        self._world.create_body(position=(0.0, 0.0, -20.0), kind="static").add_box((20.0, 20.0, 20.0), **law)
        for k in range(BODIES):
            self.reset(k, v[k], w[k])
        self.source = carom.record.box3d(self._world, (carom.record.Plane((0.0, 0.0, 1.0), 0.0, "floor"),))

    def advance(self) -> None:
        self._world.step(DT)

    def states(self) -> States:
        state = self.source.state()
        return _three(state)

    def reset(self, ball: int, v: FloatArray, w: FloatArray) -> None:
        self._balls[ball].linear_velocity, self._balls[ball].angular_velocity = v, w

    def close(self) -> None:
        self._world.destroy()


class MuJoCoBalls:
    """MuJoCo, whose contacts are springs with the same coefficient of restitution."""

    def __init__(self, places: FloatArray, v: FloatArray, w: FloatArray) -> None:
        import mujoco

        self._mujoco = mujoco
        spring = 'solref="-40000 -63" solimp="0.99 0.99 0.001 0.5 2"'
        law = f'friction="{FRICTION} 0 0" {spring}'
        text = "".join(
            f'<body pos="{" ".join(map(str, place))}"><freejoint/><geom size="{RADIUS}" mass="{MASS}" {law}/></body>'
            for place in places
        )
        floor = f'<geom name="floor" type="plane" size="0 0 1" {law}/>'
        option = f'<option timestep="{DT}" gravity="0 0 {G[2]}" cone="elliptic"/>'
        self._model = mujoco.MjModel.from_xml_string(f"<mujoco>{option}<worldbody>{floor}{text}</worldbody></mujoco>")
        self._data = mujoco.MjData(self._model)
        self.source = carom.record.mujoco(self._model, self._data, contacts=False)
        for k in range(BODIES):
            self.reset(k, v[k], w[k])

    def advance(self) -> None:
        self._mujoco.mj_step(self._model, self._data)

    def states(self) -> States:
        state = self.source.state()
        return _three(state)

    def reset(self, ball: int, v: FloatArray, w: FloatArray) -> None:
        turn = np.empty(9)
        self._mujoco.mju_quat2Mat(turn, self._data.qpos[7 * ball + 3 : 7 * ball + 7])
        self._data.qvel[6 * ball : 6 * ball + 6] = np.concatenate((v, turn.reshape(3, 3).T @ w))

    def close(self) -> None:
        """Nothing is to be released."""


ENGINES: dict[str, Any] = {"pybullet": BulletBalls, "box3d": BoxBalls, "mujoco": MuJoCoBalls}


class Impact(NamedTuple):
    """An impact of a step."""

    ends: tuple[int, int]  # balls, or a ball and the floor
    impulse: FloatArray  # N s, on the second end
    normal: FloatArray  # from the first end to the second
    speed: float  # m/s, closing
    depth: float  # m, overlap that the step would have left without the impact


class PatchedEngine:
    """Twelve balls that fall on a floor; a fault acts on impacts of pairs that touch nothing else."""

    def __init__(self, engine: str, fault: str = "", seed: int = 3) -> None:
        rng = np.random.default_rng(seed)
        grid = np.array([[k % 3, k // 3 % 2, k // 6 + 0.6] for k in range(BODIES)])
        places, v, w = np.empty((BODIES, 3)), np.empty((BODIES, 3)), np.empty((BODIES, 3))
        for k in range(BODIES):
            places[k] = SPACING * grid[k] + rng.uniform(-0.01, 0.01, 3)
            v[k], w[k] = rng.uniform(-2, 2, 3), rng.uniform(-8, 8, 3)
        self.balls: Balls = ENGINES[engine](places, v, w)
        self.model = self.balls.source.model
        self.fault, self.steps = fault, 0
        self.planted: list[tuple[int, tuple[int, ...]]] = []  # steps and ends on which the fault acted
        self.last: dict[tuple[int, int], FloatArray] = {}  # N s, impulses of the last step

    def state(self) -> carom.record.State:
        """Return the present state; with one of the faults, spins are those in the frames of the balls."""
        state: carom.record.State = self.balls.source.state()
        if self.fault == "spin in the wrong frame":
            axis, real = -np.asarray(state.orientation, float)[:, :3], np.asarray(state.orientation, float)[:, 3:]
            spin = np.asarray(state.angular_velocity, float)
            twice = 2.0 * np.cross(axis, spin)
            state.angular_velocity = spin + real * twice + np.cross(axis, twice)
        return state

    def step(self) -> None:
        """Make a step, and patch what it left."""
        self.steps += 1
        x, v, w = self.balls.states()
        self.balls.advance()
        last, self.last = self.last, {}
        met = list(self._impacts(x, v))
        self.last = {impact.ends: impact.impulse for impact in met}
        if self.fault == "gravity twice in a substep" and self.steps == 20:
            self._act(7)
            self._push(7, BODIES, -MASS * DT * G, np.array([0.0, 0.0, -1.0]))
        elif self.fault == "spin in the wrong frame":
            change = self.balls.states()[1] - v - G * DT
            if (hit := np.flatnonzero(np.einsum("ij,ij->i", change, change) > (0.1 * HARD) ** 2)).size:
                self._act(*hit.tolist())
        elif self.fault == "warm start that is not reset":
            for ends, impulse in last.items():
                if ends not in self.last and len(self.planted) < OCCASIONS:
                    self._act(*ends)
                    self._push(*ends, impulse, impulse / np.sqrt(impulse @ impulse))
        else:
            for impact in met:
                self._patch(impact, w)

    def _patch(self, impact: Impact, spin: FloatArray) -> None:
        """Let the fault act on an impact, given the spins before the step."""
        ends, impulse, normal, speed, depth = impact
        along = float(impulse @ normal) * normal
        across = impulse - along
        Kn = (1.0 if ends[1] == BODIES else 2.0) / MASS
        parting = PARTS * depth / DT / Kn * normal
        slips = np.sqrt(across @ across) > 0.1 * np.sqrt(along @ along)
        further = {
            "friction along the slip": -2.0 * across if slips else None,
            "restitution twice": RESTITUTION * along,
            "restitution by the wrong material": along * (WRONG - RESTITUTION) / (1.0 + RESTITUTION),
            "energy by overlap": parting if depth > 0.002 else None,
            "contact missed in one step": -impulse,
            "normal flipped": -2.0 * impulse,
            "position correction that adds speed": parting if depth > 0.001 else None,
        }.get(self.fault)
        turns = self.fault == "inertia of a disc" and slips
        one = self.fault == "impulse to one body only" and ends[1] < BODIES
        if len(self.planted) == OCCASIONS or speed < HARD or not (further is not None or turns or one):
            return
        self._act(*ends)
        if one:
            self._push(BODIES, ends[1], -impulse, normal)
        elif turns:
            _, v, w = self.balls.states()
            for end in ends:
                if end < BODIES:
                    self.balls.reset(end, v[end], spin[end] + (w[end] - spin[end]) / 1.25)
        else:
            assert further is not None
            self._push(*ends, further, normal)

    def _impacts(self, x: FloatArray, v: FloatArray) -> Iterator[Impact]:
        """Yield each impact of two ends that touch nothing else, given the states before the step."""
        _, after, _ = self.balls.states()
        away = x[None] - x[:, None]
        gap = np.sqrt(np.einsum("ijk,ijk->ij", away, away)) - 2.0 * RADIUS + 1e9 * np.eye(BODIES)
        floor = x[:, 2] - RADIUS
        near = (gap < NEAR).sum(axis=1) + (floor < NEAR)
        change = MASS * (after - v - G * DT)
        for i in range(BODIES):
            if near[i] != 1:
                continue
            j = BODIES if floor[i] < NEAR else int(gap[i].argmin())
            if j < i or (j < BODIES and near[j] != 1) or not np.sqrt(change[i] @ change[i]) > 0.1 * HARD * MASS:
                continue
            normal = np.array([0.0, 0.0, -1.0]) if j == BODIES else away[i, j] / np.sqrt(away[i, j] @ away[i, j])
            relative = -v[i] if j == BODIES else v[j] - v[i]
            speed = -float(relative @ normal)
            depth = speed * DT - float(floor[i] if j == BODIES else gap[i, j])
            yield Impact((i, j), -change[i], normal, speed, max(0.0, depth))

    def _act(self, *ends: int) -> None:
        self.planted.append((self.steps, ends))

    def _push(self, i: int, j: int, impulse: FloatArray, normal: FloatArray) -> None:
        """Add an impulse (N s) on j, and its opposite on i."""
        _, v, w = self.balls.states()
        turn = RADIUS * np.cross(normal, impulse) / INERTIA
        for end, sign in ((i, -1.0), (j, 1.0)):
            if end < BODIES:
                self.balls.reset(end, v[end] + sign * impulse / MASS, w[end] - turn)


def recorded(engine: PatchedEngine, path: Path) -> list[carom.record.Fault]:
    """Record a run, and return the laws that it broke."""
    with carom.record.Recorder(engine, path, force=True) as recorder:
        for _ in range(STEPS):
            engine.step()
            recorder.frame()
    engine.balls.close()
    assert recorder.problems == []
    return recorder.faults


def main(engine: str, seeds: range) -> None:
    """Print the table of an engine."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "run.rrd"
        for fault in ("", *PLANTED):
            laws, runs = Counter[str](), 0
            for seed in seeds:
                run = Toy(fault, seed) if engine == "toy" else PatchedEngine(engine, fault, seed)
                faults = recorded_toy(run, path) if isinstance(run, Toy) else recorded(run, path)
                if run.planted or not fault:
                    runs += 1
                    laws[naming_law(run.planted, faults) if fault else "accused" * bool(faults)] += 1
            named = ", ".join(f"`{law}` {count}" for law, count in laws.most_common() if law)
            print(f"| {fault or 'none'} | {runs - laws['']} of {runs} | {named} |", flush=True)  # noqa: T201


if __name__ == "__main__":
    main(sys.argv[1], range(*map(int, sys.argv[2:])) if sys.argv[2:] else range(20, 30))
