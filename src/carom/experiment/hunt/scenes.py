"""Random scenes over the switches of the model: sizes, speeds and masses over decades, and bodies about to meet.

Numbers come from coarse grids, which make ties, exact touches and exact zeros frequent.
"""

from __future__ import annotations

import math
import random
from typing import Any

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
Document = dict[str, Any]

STEPS = 60  # that bodies of usual speeds need to meet, about
MOST_BODIES = 16
CROWD = 0.2  # of scenes have a few hundred bodies, which other search and solving paths need
GAPS = (0.0, 0.0, 0.01, 0.1, 1.0)  # of radii, between a body and the one that it is placed beside


def drawn(seed: int, index: int) -> Document:
    """Draw a scene; the same numbers give the same scene."""
    return _Draw(random.Random(f"{seed} {index}")).scene(index)


class _Draw:
    """Draws a scene with a length L, a speed U and a mass M."""

    def __init__(self, rng: random.Random) -> None:
        self._rng = rng
        self._L, self._U, self._M = self._decade(-3, 4), self._decade(-4, 3), self._decade(-3, 9)  # m, m/s, kg

    def scene(self, index: int) -> Document:
        """Draw it."""
        rng, T = self._rng, self._L / self._U
        space = rng.choice(("open", "open", "periodic", "walls", "floor"))
        bodies = self._crowd() if rng.random() < CROWD else self._bodies()
        pulls = space != "periodic" and rng.random() < 0.3
        falls = space != "periodic" and rng.random() < 0.5
        document: Document = {
            "title": f"Hunted scene {index}",
            "body": bodies,
            "time": self._time(T),
            "gravity": self._gravity(pulls, falls),
            "contact": self._contact(),
            "record": {"every": "step"},
        }
        if space in ("periodic", "walls"):
            size = [max(extent, 4.0 * self._largest(bodies)) for extent in self._recentred(bodies)]
            document["domain"] = {"boundary": space, "size": size}
        elif space == "floor":
            lowest = min(body["position"][2] - body["radius"] for body in bodies)
            document["plane"] = [{"point": [0.0, 0.0, lowest - rng.choice(GAPS) * self._L]}]
        elif rng.random() < 0.2:
            bodies[0] = {key: value for key, value in bodies[0].items() if "velocity" not in key} | {"fixed": True}
        if rng.random() < 0.15:
            document["drag"] = {"relaxation_time": T * self._decade(-1, 1), "medium_velocity": self._vector(self._U)}
        return document

    def _time(self, T: float) -> Document:
        rng = self._rng
        time: Document = {
            "duration": T * rng.choice((0.3, 1.0, 3.0)),
            "max_dt": T * rng.choice((0.02, 0.1, 1.0)),
            "integrator": rng.choice(("auto", "auto", "leapfrog", "yoshida4", "gauss-radau15")),
        }
        if rng.random() < 0.4:
            time["fixed_dt"] = T / rng.choice((16, 64, 256))
        elif rng.random() < 0.2:
            time["velocity_limit"] = "fastest-body"
        return time

    def _gravity(self, pulls: bool, falls: bool) -> Document:
        rng, scale = self._rng, self._U * self._U
        gravity: Document = {"constant": rng.choice((0.1, 1.0)) * scale * self._L / self._M if pulls else 0.0}
        if pulls:
            gravity["softening"] = rng.choice((0.0, 0.1, 1.0)) * self._L
            gravity["method"] = rng.choice(("auto", "direct", "tree"))
        if falls:
            gravity["uniform"] = rng.choice(([0.0, 0.0, -scale / self._L], self._vector(scale / self._L)))
        return gravity

    def _contact(self) -> Document:
        rng = self._rng
        static = rng.choice((0.0, 0.0, 0.1, 0.5, 1.0))
        contact: Document = {
            "restitution": rng.choice((0.0, 0.5, 0.9, 1.0)),
            "static_friction": static,
            "kinetic_friction": static * rng.choice((0.5, 1.0)),
            "solver": rng.choice(("lasting", "lasting", "staged")),
            "colouring": rng.choice(("contacts", "bodies")),
            "stabilisation": rng.choice(("split", "split", "none")),
            "timing": rng.choice(("auto", "auto", "end-of-step", "time-of-impact")),
            "search": rng.choice(("grid", "grid", "k-d-tree")),
        }
        if rng.random() < 0.1:
            contact["enabled"] = False
        return {key: value for key, value in contact.items() if rng.random() < 0.6}

    def _bodies(self) -> list[Document]:
        """Draw a few bodies, each beside one placed before it, so that most meet."""
        rng, alike = self._rng, self._rng.random() < 0.5
        bodies: list[Document] = []
        for index in range(rng.randint(1, MOST_BODIES)):
            radius = self._L if alike else self._L * self._decade(-1, 1)
            position = np.zeros(3)
            for _ in range(20):
                if not bodies:
                    break
                beside = rng.choice(bodies)
                ray = self._direction()
                reach = (radius + beside["radius"]) * (1.0 + 1e-12) + rng.choice(GAPS) * min(radius, beside["radius"])
                position = np.array(beside["position"]) + reach * ray
                if all(math.dist(position, b["position"]) >= radius + b["radius"] for b in bodies):
                    break
            else:
                continue
            bodies.append(self._body(index, position, radius, alike))
        return bodies

    def _crowd(self) -> list[Document]:
        """Draw some hundred bodies on a jittered grid, of which neighbours may touch within a step."""
        rng, side = self._rng, self._rng.randint(5, 7)
        pitch = 2.0 * self._L * rng.choice((1.0 + 1e-9, 1.05, 1.3))
        slack = 0.5 * pitch - self._L
        bodies = []
        for index in range(side**3):
            place = np.array([index % side, index // side % side, index // side**2]) - 0.5 * (side - 1)
            jitter = np.array([rng.uniform(-slack, slack) for _ in range(3)])
            bodies.append(self._body(index, pitch * place + jitter, self._L, alike=True))
        return bodies

    def _body(self, index: int, position: FloatArray, radius: float, alike: bool) -> Document:
        rng = self._rng
        body: Document = {
            "name": f"ball {index}",
            "position": [float(x) for x in position],
            "velocity": self._vector(self._U),
            "radius": radius,
            "mass": self._M if alike else self._M * self._decade(-2, 2),
        }
        if rng.random() < 0.3:
            body["angular_velocity"] = self._vector(self._U / radius)
        if rng.random() < 0.1:
            body["inertia_factor"] = rng.choice((2 / 3, 0.05))
        return body

    def _recentred(self, bodies: list[Document]) -> list[float]:
        """Move the middle of the bodies to the origin; return the size of a box around them."""
        position = np.array([body["position"] for body in bodies])
        radius = np.array([body["radius"] for body in bodies])[:, None]
        low, high = (position - radius).min(axis=0), (position + radius).max(axis=0)
        for body, x in zip(bodies, position - 0.5 * (low + high), strict=True):
            body["position"] = [float(value) for value in x]
        slack = self._rng.choice((1.0 + 1e-9, 1.1, 2.0))
        return [float(value) for value in (high - low) * slack]

    def _largest(self, bodies: list[Document]) -> float:
        return max(float(body["radius"]) for body in bodies)

    def _decade(self, low: int, high: int) -> float:
        """Draw from 10^low to 10^high, four values a decade."""
        return float(10.0 ** (self._rng.randint(4 * low, 4 * high) / 4))

    def _vector(self, size: float) -> list[float]:
        return [size * self._rng.randint(-4, 4) / 4 for _ in range(3)]

    def _direction(self) -> FloatArray:
        while True:
            vector = np.array(self._vector(1.0))
            if vector.any():
                return np.asarray(vector / np.linalg.norm(vector))
