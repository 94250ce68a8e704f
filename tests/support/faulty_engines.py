"""A small engine of contacts with a fault on demand, and the laws that name each fault."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

import carom

BODIES, STEPS, DT = 12, 160, 1.0 / 480.0  # s; later, the toy sinks into the floor
G = np.array([0.0, 0.0, -9.81])
RADIUS, MASS, RESTITUTION, FRICTION = 0.1, 0.5, 0.6, 0.3
INERTIA = 0.4 * MASS * RADIUS**2
OCCASIONS = 3
SLOW = 0.2  # m/s, below which nothing rebounds
EXCESS = 0.8  # of an overlap, which the wrong corrections of positions return as speed in a step


class Toy:
    """Twelve balls that fall on a floor, with sequential impulses; a fault acts from its first occasion on."""

    def __init__(self, fault: str = "", seed: int = 3) -> None:
        rng = np.random.default_rng(seed)
        grid = [[0.22 * (k % 3), 0.22 * (k // 3 % 2), 0.13 + 0.25 * (k // 6)] for k in range(BODIES)]
        self.x = np.array(grid) + rng.uniform(-0.009, 0.009, (BODIES, 3))
        self.v, self.w = rng.uniform(-1, 1, (BODIES, 3)), rng.uniform(-5, 5, (BODIES, 3))
        self.turn = np.tile(np.eye(3), (BODIES, 1, 1))
        self.fault, self.steps = fault, 0
        self.inertia = INERTIA * (1.25 if fault == "inertia of a disc" else 1.0)
        self.planted: list[tuple[int, tuple[int, ...]]] = []  # steps and ends on which the fault acted
        self.touched: set[int] = set()
        self.last: dict[tuple[int, int], np.ndarray] = {}
        self.model = carom.record.Model(
            engine="toy 1.0",
            mass=np.full(BODIES, MASS),
            radius=np.full(BODIES, RADIUS),
            gravity=tuple(G),
            planes=[carom.record.Plane((0, 0, 1), 0.0, "floor")],
        )

    def act(self, fault: str, *ends: int) -> bool:
        """Return whether a fault acts now: on its first occasions, lest the engine explode."""
        acts = self.fault == fault and len(self.planted) < OCCASIONS
        if acts:
            self.planted.append((self.steps, ends))
        return acts

    def state(self) -> carom.record.State:
        spin = np.einsum("nji,nj->ni", self.turn, self.w) if self.fault == "spin in the wrong frame" else self.w
        orientation = Rotation.from_matrix(self.turn).as_quat()
        return carom.record.State(self.steps * DT, self.x, self.v, orientation, spin)

    def step(self) -> None:
        self.steps += 1
        self.v += G * DT
        if self.steps == 20 and self.act("gravity twice in a substep", 7):
            self.v[7] += G * DT
        self.x += self.v * DT
        self.turn = Rotation.from_rotvec(DT * self.w).as_matrix() @ self.turn
        self.touched.clear()
        last, self.last = self.last, {}
        away = self.x[None] - self.x[:, None]
        distances = np.sqrt(np.einsum("ijk,ijk->ij", away, away))
        for i in range(BODIES):
            if self.x[i, 2] < RADIUS:
                self.collide(i, BODIES, np.array([0, 0, -1.0]), RADIUS - self.x[i, 2])
            for j in np.flatnonzero(distances[i, i + 1 :] < 2 * RADIUS) + i + 1:
                self.collide(i, int(j), away[i, j] / distances[i, j], 2 * RADIUS - distances[i, j])
        if self.fault == "warm start that is not reset":
            for pair, impulse in last.items():
                if pair not in self.last and self.act(self.fault, *pair):
                    self.push(*pair, impulse, impulse / np.linalg.norm(impulse))

    def collide(self, i: int, j: int, normal: np.ndarray, depth: float) -> None:
        ends, Kn = (i, j), (1.0 if j == BODIES else 2.0) / MASS
        slip = self.slip(*ends, normal)
        un = slip @ normal
        bias = 0.0
        if depth > 0.002 and self.act("energy by overlap", *ends):
            bias = EXCESS * depth / DT
        if un >= 0.0 and bias == 0.0:
            return
        if un < -0.5 and not self.planted and self.act("contact missed in one step", *ends):
            return
        e = RESTITUTION if un < -SLOW else 0.0
        if e and 5 in ends and self.act("restitution by the wrong material", *ends):
            e = 0.95
        Jn = max(0.0, -(1.0 + e) * un + bias) / Kn
        if e and (i in self.touched or j in self.touched) and self.act("restitution twice", *ends):
            Jn *= 1.0 + e
        self.touched.update({i, j} - {BODIES})
        tangential = slip - un * normal
        speed = np.linalg.norm(tangential)
        impulse = Jn * normal
        if speed > 1e-9:
            wrong = np.linalg.norm(self.w[i]) > 5.0 and self.act("friction along the slip", *ends)
            sign = 1.0 if wrong else -1.0
            K = Kn * (1.0 + MASS * RADIUS**2 / self.inertia)
            impulse = impulse + sign * min(FRICTION * Jn, speed / K) * tangential / speed
        if e and un < -0.5 and self.act("normal flipped", *ends):
            impulse = -impulse
        if e and j < BODIES and self.act("impulse to one body only", *ends):
            self.v[i] -= impulse / MASS
            return
        if self.fault == "inertia of a disc" and speed > 0.1:
            self.act(self.fault, *ends)
        if self.fault == "spin in the wrong frame":
            self.act(self.fault, *ends)
        self.push(i, j, impulse, normal)
        self.last[ends] = impulse
        if depth > 0.001 and self.act("position correction that adds speed", *ends):
            self.push(*ends, 0.8 * depth / DT / Kn * normal, normal)

    def push(self, i: int, j: int, impulse: np.ndarray, normal: np.ndarray) -> None:
        for end, sign in ((i, -1.0), (j, 1.0)):
            if end < BODIES:
                self.v[end] += sign * impulse / MASS
                self.w[end] -= RADIUS * np.cross(normal, impulse) / self.inertia

    def slip(self, i: int, j: int, normal: np.ndarray) -> np.ndarray:
        found: np.ndarray = -self.v[i] - RADIUS * np.cross(self.w[i], normal)
        return found if j == BODIES else found + self.v[j] - RADIUS * np.cross(self.w[j], normal)


PLANTED = {
    "friction along the slip": "friction",
    "restitution twice": "restitution",
    "restitution by the wrong material": "restitution",
    "energy by overlap": "restitution",
    "contact missed in one step": "missed-impact",
    "normal flipped": "pull",
    "inertia of a disc": "angular-momentum",
    "spin in the wrong frame": "spin",
    "impulse to one body only": "momentum",
    "gravity twice in a substep": "momentum",
    "position correction that adds speed": "restitution",
    "warm start that is not reset": "friction",
}


def recorded(toy: Toy, path: Path) -> list[carom.record.Fault]:
    """Record a run, and return the laws that it broke."""
    with carom.record.Recorder(toy, path, force=True) as recorder:
        while toy.steps < STEPS:
            toy.step()
            recorder.frame()
    assert recorder.problems == []
    return recorder.faults


def naming_law(planted: list[tuple[int, tuple[int, ...]]], faults: list[carom.record.Fault]) -> str:
    """Return the first law that names a step and a body on which a fault acted; empty if none."""
    for fault in sorted(faults, key=lambda fault: fault.step):
        if any(step == fault.step and set(ends) & set(fault.bodies) for step, ends in planted):
            return str(fault.law)
    return ""
