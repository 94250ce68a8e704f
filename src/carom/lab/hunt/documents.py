"""Random scenes as documents: bodies about to meet, softened bodies that attract each other, pairs that meet once.

Sizes, speeds and masses span decades, in units that are not powers of two, so that sums are rounded. Numbers are drawn
from coarse grids, by a random number generator or a test library. This makes ties, exact contacts and exact zeros
frequent, which reveal mistakes.
"""

from __future__ import annotations

import itertools
import math
import random
from typing import Any, NamedTuple, Protocol, TypeVar

import numpy as np

from carom.arrays import FloatArray

Value = TypeVar("Value")

# Vectors of multiples of 1/4 up to 1, simplest first; one draw gives a whole vector, since three draws would take most
# of the time
QUARTERS = np.array(sorted(itertools.product(np.arange(-4, 5) / 4, repeat=3), key=lambda v: (np.abs(v).sum(), *v)))
DIRECTIONS = QUARTERS[1:] / np.linalg.norm(QUARTERS[1:], axis=1, keepdims=True)


class Draw(Protocol):
    """A source of random choices."""

    def choice(self, *values: Value) -> Value:
        """Draw one of the given values."""

    def integer(self, low: int, high: int) -> int:
        """Draw a whole number from ``low`` to ``high``, both included."""


class RandomDraw:
    """Draws with a seed."""

    def __init__(self, seed: str) -> None:
        self._rng = random.Random(seed)

    def choice(self, *values: Value) -> Value:
        """Draw one of the given values."""
        return self._rng.choice(values)

    def integer(self, low: int, high: int) -> int:
        """Draw a whole number from ``low`` to ``high``, both included."""
        return self._rng.randint(low, high)


def one_in(draw: Draw, count: int) -> bool:
    """Draw a boolean that is true once in ``count`` draws on average."""
    return draw.integer(0, count - 1) == count - 1


def fraction(draw: Draw) -> float:
    """Draw a fraction of one, in eighths."""
    return draw.integer(0, 8) / 8


def decade(draw: Draw, low: int, high: int) -> float:
    """Draw from 10^low to 10^high, four values a decade."""
    return float(10.0 ** (draw.integer(4 * low, 4 * high) / 4))


def vector(draw: Draw) -> FloatArray:
    """Draw a vector of multiples of 1/4, up to 1 in each direction."""
    return np.asarray(QUARTERS[draw.integer(0, len(QUARTERS) - 1)])


def direction(draw: Draw) -> FloatArray:
    """Draw a unit vector."""
    return np.asarray(DIRECTIONS[draw.integer(0, len(DIRECTIONS) - 1)])


def row(values: FloatArray) -> list[float]:
    """Return a vector in the form of a scene file."""
    return [float(value) for value in values]


Document = dict[str, Any]  # a scene as a dictionary with the keys of a TOML file; it can be changed before validation


class Scales(NamedTuple):
    """A length in m, a speed in m/s and a mass in kg."""

    L: float
    U: float
    M: float


def scales(draw: Draw) -> Scales:
    """Draw the scales of a scene."""
    return Scales(decade(draw, -3, 4), decade(draw, -4, 3), decade(draw, -3, 9))


def meeting(
    draw: Draw,
    *,
    scale: Scales | None = None,
    gravity: bool | None = None,
    field: bool | None = None,
    periodic: bool | None = None,
    fixed_step: bool | None = None,
    velocity_limit: str | None = None,
    stabilisation: str | None = None,
    most_bodies: int = 12,
    drift: float = 1000.0,
) -> Document:
    """Draw a valid scene of a few bodies that meet within some 30 steps; arguments that are None are drawn at random.

    A fixed step is a power of two, so that the clock is exact. All bodies may share a velocity of ``drift`` times their
    usual speed.
    """

    def choose(given: bool | None) -> bool:
        return draw.choice(False, True) if given is None else given

    has_gravity, has_field = choose(gravity), choose(field)
    # With an adaptive step, Baumgarte's bias diverges for squeezed bodies; test_random_scenes.py has such a scene.
    undoing = stabilisation or draw.choice("split", "none", *(["baumgarte"] if fixed_step is not False else []))
    fixed = undoing == "baumgarte" or choose(fixed_step)
    wraps = not has_gravity and not has_field and choose(periodic)
    L, U, M = scale or scales(draw)
    overlapping = not wraps and draw.integer(0, 3) == 0
    bodies = _bodies(draw, L, U, M, draw.integer(1, most_bodies), overlapping, drift)
    static = draw.choice(0.0, 0.1, 0.5, 1.0, 10.0)
    time = _time(draw, L, U, fixed, velocity_limit)
    document: Document = {
        "body": bodies,
        "time": time,
        "gravity": {"constant": 0.0},
        "contact": {
            "enabled": draw.integer(0, 7) > 0,
            "restitution": fraction(draw),
            "static_friction": static,
            "kinetic_friction": static * fraction(draw),
            "colouring": draw.choice("contacts", "bodies"),
            "stabilisation": undoing,
            "timing": _timing(draw, time["integrator"]),
            "sweeps": draw.choice("auto", "auto", "as-needed", "quick", 1, 8),
            "allow_overlap": overlapping,
        },
        "record": {"every": "step", "check_every": 1},
    }
    if has_gravity:
        # The model excludes overlapping bodies without softening, since their attraction is unbounded (physics.md, 16).
        soft = draw.choice(0.1, 1.0) if overlapping else draw.choice(0.0, 0.0, 0.1, 1.0)
        document["gravity"] = {"constant": decade(draw, -3, 2) * U * U * L / M, "softening": soft * L}
    if has_field:
        document["gravity"]["uniform"] = row(vector(draw) * (decade(draw, -2, 1) * U * U / L))
    if wraps:
        slack = draw.choice(0.0, 0.125, 1.0)
        # bodies in the box do not overlap; with a slack of 0, the outermost bodies touch through the boundary
        position = np.array([body["position"] for body in bodies])
        radius = np.array([body["radius"] for body in bodies])[:, None]
        extent = (position + radius).max(axis=0) - (position - radius).min(axis=0)
        document["domain"] = {
            "boundary": "periodic",
            "size": row(np.maximum(extent * (1.0 + slack), 4.0 * radius.max())),
        }
    return document


def _bodies(draw: Draw, L: float, U: float, M: float, count: int, overlapping: bool, drift: float) -> list[Document]:
    """Draw bodies, each beside an earlier one: touching it, at a distance, or overlapping it if ``overlapping``."""
    alike, spinning = draw.choice(False, True), draw.choice(False, True)
    bulk = vector(draw) * draw.choice(0.0, 1.0, drift)
    gaps = [0.0, 0.0, 0.01, 0.1, 1.0, 10.0] + ([-0.1, -0.5, -1.0] if overlapping else [])
    placed: list[tuple[FloatArray, float]] = []
    bodies: list[Document] = []
    for index in range(count):
        radius = L if alike else L * decade(draw, -2, 2)
        if index == 0:
            position = vector(draw) * (10 * L)
        else:
            parent, parent_radius = placed[draw.integer(0, index - 1)]
            gap, ray = draw.choice(*gaps), direction(draw)
            reach = radius + parent_radius
            distance = reach + gap * (reach if gap < 0 else min(radius, parent_radius))
            if not overlapping:
                distance = _clear(parent, ray, distance, radius, placed)
            position = parent + distance * ray
        placed.append((position, radius))
        spin = vector(draw) * (U / radius) if spinning else np.zeros(3)
        bodies.append(
            {
                "position": row(position),
                "velocity": row((bulk + vector(draw)) * U),
                "angular_velocity": row(spin),
                "radius": radius,
                "mass": M if alike else M * decade(draw, -3, 3),
                "inertia_factor": draw.choice(0.4, 0.4, 2 / 3, 0.05),
            }
        )
    return bodies


def _clear(
    origin: FloatArray, ray: FloatArray, distance: float, radius: float, placed: list[tuple[FloatArray, float]]
) -> float:
    """Return the distance along a ray at which a sphere overlaps no placed body."""
    blocked = []
    for centre, other in placed:
        along = float((centre - origin) @ ray)
        aside = centre - origin - along * ray  # Pythagoras' theorem would lose digits at large distances
        chord = (radius + other) ** 2 - float(aside @ aside)  # squared half-length of the chord
        if chord > 0.0:
            blocked.append((along - math.sqrt(chord), along + math.sqrt(chord)))
    for entry, exit_ in sorted(blocked):  # in the order of entry, so no later interval begins earlier
        if entry < distance < exit_:
            distance = exit_
    return distance


def _timing(draw: Draw, integrator: str) -> str:
    """Draw the timing of impacts; Yoshida's method drifts back in time, which excludes exact impacts."""
    return draw.choice("auto", "end-of-step", *(["time-of-impact"] if integrator != "yoshida4" else []))


def _time(draw: Draw, L: float, U: float, fixed: bool, velocity_limit: str | None) -> Document:
    T = L / U
    reach = draw.choice(None, 0.001, 0.01, 0.1, 1.0)
    time: Document = {
        "duration": 1e9 * T,  # so long that the number of steps ends the run
        "integrator": draw.choice("euler", "leapfrog", "yoshida4"),
        "max_dt": T * decade(draw, -2, 1),
        "target_dx": "auto" if reach is None else L * reach,
        "cfl": draw.choice(0.05, 0.5, 1.0),
        "smoothing": draw.choice(0.01, 0.2, 1.0),
        "velocity_limit": velocity_limit or draw.choice("every-body", "fastest-body"),
    }
    if fixed:
        time["fixed_dt"] = 2.0 ** round(math.log2(T * decade(draw, -3, 0)))
    return time


def smooth(draw: Draw, *, steps: int, integrators: tuple[str, ...]) -> Document:
    """Draw softened bodies that attract and pass through each other, so that their motion is smooth.

    The step is a fraction of 1/λ, with λ² = 2 G M/ε³, chosen so that the run lasts at most half of 1/λ. The gradient of
    Plummer's force is at most G m/ε³, so two runs diverge no faster than exp(λ t).
    """
    count = draw.integer(2, 8)
    L, M = decade(draw, -3, 4), decade(draw, -3, 9)
    mass = [M * decade(draw, -3, 3) for _ in range(count)]
    softening = L * draw.choice(0.25, 1.0)
    rate = 10.0 ** draw.integer(-3, 3)  # λ, 1/s
    constant = 0.5 * rate**2 * softening**3 / sum(mass)
    bodies = [
        {
            "position": row(vector(draw) * (4 * L)),
            "velocity": row(vector(draw) * (L * rate)),
            "angular_velocity": row(vector(draw) * (10 * rate)),
            "radius": 0.3 * L,
            "mass": m,
        }
        for m in mass
    ]
    return {
        "body": bodies,
        "time": {
            "duration": 1e9 / rate,
            "fixed_dt": draw.choice(0.1, 0.5) / (steps * rate),
            "integrator": draw.choice(*integrators),
        },
        "gravity": {
            "constant": constant,
            "softening": softening,
            "uniform": row(vector(draw) * (L * rate * rate)),
        },
        "contact": {"enabled": False},
        "record": {"every": "step", "check_every": 1},
    }


def impacts(draw: Draw) -> Document:
    """Draw pairs, far from one another; the bodies of a pair collide once, within the first six steps of 2⁻⁶ s.

    An impact is resolved at the end of its step. Round-off must not move an impact to another step, so each impact
    happens at 0.3 to 0.7 of a step, and at least 17° from grazing. Static and kinetic friction are equal, so that the
    result is continuous at the onset of sliding.
    """
    dt = 2.0**-6
    bodies: list[Document] = []
    for site in range(draw.integer(1, 4)):
        radii = [decade(draw, -1, 1), decade(draw, -1, 1)]
        reach = sum(radii)
        normal = direction(draw)
        across = np.cross(normal, direction(draw))
        across = across / np.linalg.norm(across) if across.any() else across
        head_on = draw.choice(0.3, 0.6, 1.0)
        speed = draw.choice(0.02, 0.1, 0.2) * reach / dt
        approach = speed * (-head_on * normal + math.sqrt(1.0 - head_on**2) * across)
        touching = (draw.integer(0, 5) + draw.choice(0.3, 0.5, 0.7)) * dt  # s, time of the impact
        own = vector(draw) * speed
        first = np.array([1000.0 * site, 0.0, 0.0]) + vector(draw)
        for k in range(2):
            bodies.append(
                {
                    "position": row(first + k * (reach * normal - touching * approach)),
                    "velocity": row(own + k * approach),
                    "angular_velocity": row(vector(draw) * (speed / radii[k])),
                    "radius": radii[k],
                    "mass": decade(draw, -3, 3),
                }
            )
    friction = draw.choice(0.0, 0.1, 0.5, 10.0)
    return {
        "body": bodies,
        "time": {"duration": 10.0, "fixed_dt": dt, "integrator": draw.choice("euler", "leapfrog")},
        "gravity": {"constant": 0.0},
        "contact": {
            "restitution": fraction(draw),
            "static_friction": friction,
            "kinetic_friction": friction,
            "stabilisation": draw.choice("split", "baumgarte", "none"),
            "timing": _timing(draw, "leapfrog"),
            "colouring": draw.choice("contacts", "bodies"),
        },
        "record": {"every": "step", "check_every": 1},
    }
