"""PyBullet with a fault on demand: after a step, balls that met get the velocities that the fault would leave.

``python tests/support/patched_bullet.py [SEEDS]`` prints how many runs of twelve balls name each fault, and how many
accuse PyBullet alone.
"""

from __future__ import annotations

import sys
import tempfile
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pybullet

import carom
from faulty_engines import BODIES, DT, FRICTION, INERTIA, MASS, OCCASIONS, PLANTED, RADIUS, RESTITUTION, SHOWN_LATER, G

STEPS = 480
HARD = 0.5  # m/s, closing speed of the impacts that are patched
NEAR = 0.02  # m, gap up to which two balls may touch in a step
SPACING = 0.33  # m, of the balls at the start
PARTS = 0.8  # of an overlap that wrong corrections return as speed in a step
WRONG = 0.95  # coefficient of restitution of another material


class Impact(NamedTuple):
    """An impact of a step."""

    ends: tuple[int, int]  # balls, or a ball and the floor
    impulse: np.ndarray  # N s, on the second end
    normal: np.ndarray  # from the first end to the second
    speed: float  # m/s, closing
    depth: float  # m, overlap that the step would have left without the impact


class PatchedBullet:
    """Twelve balls that fall on a floor in PyBullet; a fault acts on impacts of pairs that touch nothing else."""

    def __init__(self, fault: str = "", seed: int = 3) -> None:
        rng = np.random.default_rng(seed)
        self.client = pybullet.connect(pybullet.DIRECT)
        where = {"physicsClientId": self.client}
        pybullet.setGravity(*G, **where)
        pybullet.setTimeStep(DT, **where)
        plane = pybullet.createMultiBody(0, pybullet.createCollisionShape(pybullet.GEOM_PLANE, **where), **where)
        ball = pybullet.createCollisionShape(pybullet.GEOM_SPHERE, radius=RADIUS, **where)
        self.balls = []
        for k in range(BODIES):
            place = SPACING * np.array([k % 3, k // 3 % 2, k // 6 + 0.6]) + rng.uniform(-0.01, 0.01, 3)
            body = pybullet.createMultiBody(MASS, ball, basePosition=place.tolist(), **where)
            pybullet.resetBaseVelocity(body, rng.uniform(-2, 2, 3).tolist(), rng.uniform(-8, 8, 3).tolist(), **where)
            self.balls.append(body)
        for body in (plane, *self.balls):  # coefficients of two bodies are multiplied
            pybullet.changeDynamics(
                *(body, -1),
                restitution=float(np.sqrt(RESTITUTION)),
                lateralFriction=float(np.sqrt(FRICTION)),
                linearDamping=0.0,
                angularDamping=0.0,
                **where,
            )
        self.source = carom.record.pybullet(DT, tuple(G.tolist()), self.client, contacts=False)
        self.model = self.source.model
        self.fault, self.steps = fault, 0
        self.planted: list[tuple[int, tuple[int, ...]]] = []  # steps and ends on which the fault acted
        self.last: dict[tuple[int, int], np.ndarray] = {}  # N s, impulses of the last step

    def close(self) -> None:
        """End PyBullet's server."""
        pybullet.disconnect(self.client)

    def state(self) -> carom.record.State:
        """Return the present state; with one of the faults, spins are those in the frames of the balls."""
        state = self.source.state()
        if self.fault == "spin in the wrong frame":
            state.angular_velocity = np.array(
                [
                    np.array(pybullet.getMatrixFromQuaternion(quaternion)).reshape(3, 3).T @ spin
                    for quaternion, spin in zip(state.orientation, state.angular_velocity, strict=True)
                ]
            )
        return state

    def step(self) -> None:
        """Make a step, and patch what it left."""
        self.steps += 1
        x, v, w = self._states()
        pybullet.stepSimulation(physicsClientId=self.client)
        self.source.stepped()
        last, self.last = self.last, {}
        met = list(self._impacts(x, v))
        self.last = {impact.ends: impact.impulse for impact in met}
        if self.fault == "gravity twice in a substep" and self.steps == 20:
            self._act(7)
            self._push(7, BODIES, -MASS * DT * G, np.array([0.0, 0.0, -1.0]))
        elif self.fault == "spin in the wrong frame":
            for impact in met[:1]:
                self._act(*impact.ends)
        elif self.fault == "warm start that is not reset":
            for ends, impulse in last.items():
                if ends not in self.last and len(self.planted) < OCCASIONS:
                    self._act(*ends)
                    self._push(*ends, impulse, impulse / np.sqrt(impulse @ impulse))
        else:
            for impact in met:
                self._patch(impact, w)

    def _patch(self, impact: Impact, spin: np.ndarray) -> None:
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
            _, v, w = self._states()
            for end in ends:
                if end < BODIES:
                    self._reset(end, v[end], spin[end] + (w[end] - spin[end]) / 1.25)
        else:
            assert further is not None
            self._push(*ends, further, normal)

    def _impacts(self, x: np.ndarray, v: np.ndarray) -> Iterator[Impact]:
        """Yield each impact of two ends that touch nothing else, given the states before the step."""
        _, after, _ = self._states()
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

    def _push(self, i: int, j: int, impulse: np.ndarray, normal: np.ndarray) -> None:
        """Add an impulse (N s) on j, and its opposite on i."""
        _, v, w = self._states()
        turn = RADIUS * np.cross(normal, impulse) / INERTIA
        for end, sign in ((i, -1.0), (j, 1.0)):
            if end < BODIES:
                self._reset(end, v[end] + sign * impulse / MASS, w[end] - turn)

    def _reset(self, ball: int, v: np.ndarray, w: np.ndarray) -> None:
        pybullet.resetBaseVelocity(self.balls[ball], v.tolist(), w.tolist(), physicsClientId=self.client)

    def _states(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        x = [pybullet.getBasePositionAndOrientation(ball, physicsClientId=self.client)[0] for ball in self.balls]
        moving = [pybullet.getBaseVelocity(ball, physicsClientId=self.client) for ball in self.balls]
        v, w = zip(*moving, strict=True)
        return np.array(x), np.array(v), np.array(w)


def recorded(engine: PatchedBullet, path: Path) -> list[carom.record.Fault]:
    """Record a run, and return the laws that it broke."""
    with carom.record.Recorder(engine, path, force=True) as recorder:
        for _ in range(STEPS):
            engine.step()
            recorder.frame()
    engine.close()
    assert recorder.problems == []
    return recorder.faults


def naming_law(engine: PatchedBullet, faults: list[carom.record.Fault]) -> str:
    """Return the first law that names a step in which the fault acted, and a body on which it acted; empty if none."""
    for fault in sorted(faults, key=lambda fault: fault.step):
        later = engine.fault in SHOWN_LATER and fault.step >= engine.planted[0][0]
        if later or any(step == fault.step and set(ends) & set(fault.bodies) for step, ends in engine.planted):
            return str(fault.law)
    return ""


def main(seeds: range) -> None:
    """Print the table."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "run.rrd"
        accused = sum(bool(recorded(PatchedBullet(seed=seed), path)) for seed in seeds)
        print(f"without a fault, accused: {accused} of {len(seeds)}")  # noqa: T201
        for fault in PLANTED:
            laws, runs = Counter[str](), 0
            for seed in seeds:
                engine = PatchedBullet(fault, seed)
                faults = recorded(engine, path)
                if engine.planted:
                    runs, laws = runs + 1, laws + Counter([naming_law(engine, faults)])
            named = ", ".join(f"`{law}` {count}" for law, count in laws.most_common() if law)
            print(f"| {fault} | {runs - laws['']} of {runs} | {named} |", flush=True)  # noqa: T201


if __name__ == "__main__":
    main(range(*map(int, sys.argv[1:])) if sys.argv[1:] else range(20, 30))
