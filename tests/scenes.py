"""Random scenes for property tests: every switch of the model, sizes and masses over decades, bodies about to meet.

Numbers come from coarse grids times units that are no powers of two. The grids make ties, exact touches and exact
zeros frequent, which is where mistakes live, and let Hypothesis shrink a failure to something a person can read;
the units see to it that sums do round.
"""

from __future__ import annotations

import itertools
import math
from functools import cache
from typing import Any

import numpy as np
from hypothesis import strategies as st
from hypothesis.strategies import DrawFn
from numpy.typing import NDArray

from carom.scene.schema import Scene

FloatArray = NDArray[np.float64]
Document = dict[str, Any]  # a scene with the keys of a TOML file, which a test can transform before it is validated

EPS = float(np.finfo(np.float64).eps)


def scene_from(document: Document) -> Scene:
    """Validate a document. `Scene.from_dict` also writes its TOML, which takes 20 times as long and moves nothing."""
    return Scene.model_validate(document)


@cache
def decades(low: int, high: int) -> st.SearchStrategy[float]:
    """Draw from 10^low to 10^high, four values a decade."""
    return st.integers(4 * low, 4 * high).map(lambda k: float(10.0 ** (k / 4)))


@cache
def choices(*values: Any) -> st.SearchStrategy[Any]:
    """Draw one of these. A strategy is costly to build, and so each is built once."""
    return st.sampled_from(values)


# Vectors of quarters up to 1 in each direction, the simplest first. One draw each: three would take most of the time.
_QUARTERS = np.array(sorted(itertools.product(np.arange(-4, 5) / 4, repeat=3), key=lambda v: (np.abs(v).sum(), *v)))
_DIRECTIONS = _QUARTERS[1:] / np.linalg.norm(_QUARTERS[1:], axis=1, keepdims=True)
vectors = st.integers(0, len(_QUARTERS) - 1).map(lambda k: _QUARTERS[k])
directions = st.integers(0, len(_DIRECTIONS) - 1).map(lambda k: _DIRECTIONS[k])
parts = st.integers(0, 8).map(lambda k: k / 8)  # of one
switches = st.booleans()
_numbers = cache(st.integers)


@st.composite
def documents(
    draw: DrawFn,
    *,
    gravity: bool | None = None,
    field: bool | None = None,
    periodic: bool | None = None,
    fixed_step: bool | None = None,
    velocity_limit: str | None = None,
    stabilisation: str | None = None,
    most_bodies: int = 12,
) -> Document:
    """Draw a valid scene of a few bodies that meet within some 30 steps; what is None is drawn, too.

    A fixed step is a power of two, so that the clock of a run is exact.
    """

    def choose(given: bool | None) -> bool:
        return draw(switches) if given is None else given

    pulls, falls = choose(gravity), choose(field)
    # With an adaptive step Baumgarte's bias runs away where bodies are squeezed: test_random_scenes.py has the scene.
    undoing = stabilisation or draw(choices("split", "none", *(["baumgarte"] if fixed_step is not False else [])))
    fixed = undoing == "baumgarte" or choose(fixed_step)
    wraps = not pulls and not falls and choose(periodic)
    L, U, M = draw(decades(-3, 4)), draw(decades(-4, 3)), draw(decades(-3, 9))  # m, m/s, kg
    overlapping = not wraps and draw(_numbers(0, 3)) == 0
    bodies = draw(_bodies(L, U, M, draw(_numbers(1, most_bodies)), overlapping))
    static = draw(choices(0.0, 0.1, 0.5, 1.0, 10.0))
    time = draw(_time(L, U, fixed, velocity_limit))
    document: Document = {
        "body": bodies,
        "time": time,
        "gravity": {"constant": 0.0},
        "contact": {
            "enabled": draw(_numbers(0, 7)) > 0,
            "restitution": draw(parts),
            "static_friction": static,
            "kinetic_friction": static * draw(parts),
            "colouring": draw(choices("contacts", "bodies")),
            "stabilisation": undoing,
            "timing": draw(_timings(time["integrator"])),
            "sweeps": draw(choices(1, 8, 40)),
            "allow_overlap": overlapping,
        },
        "record": {"every": "step", "check_every": 1},
    }
    if pulls:
        # Bodies that overlap without softening pull each other without bound: there the model ends (physics.md, 16).
        soft = draw(choices(0.1, 1.0) if overlapping else choices(0.0, 0.0, 0.1, 1.0))
        document["gravity"] = {"constant": draw(decades(-3, 2)) * U * U * L / M, "softening": soft * L}
    if falls:
        document["gravity"]["uniform"] = _list(draw(vectors) * (draw(decades(-2, 1)) * U * U / L))
    if wraps:
        document["domain"] = {"boundary": "periodic", "size": _box(bodies, draw(choices(0.0, 0.125, 1.0)))}
    return document


@st.composite
def _bodies(draw: DrawFn, L: float, U: float, M: float, count: int, overlapping: bool) -> list[Document]:
    """Draw bodies, each beside one placed before it: touching, at a distance, or overlapping where that is allowed."""
    alike, spinning = draw(switches), draw(switches)
    bulk = draw(vectors) * draw(choices(0.0, 1.0, 1000.0))
    gaps = [0.0, 0.0, 0.01, 0.1, 1.0, 10.0] + ([-0.1, -0.5, -1.0] if overlapping else [])
    placed: list[tuple[FloatArray, float]] = []
    bodies: list[Document] = []
    for index in range(count):
        radius = L if alike else L * draw(decades(-2, 2))
        if index == 0:
            position = draw(vectors) * (10 * L)
        else:
            parent, parent_radius = placed[draw(_numbers(0, index - 1))]
            gap, ray = draw(choices(*gaps)), draw(directions)
            reach = radius + parent_radius
            distance = reach + gap * (reach if gap < 0 else min(radius, parent_radius))
            if not overlapping:
                distance = _clear(parent, ray, distance, radius, placed)
            position = parent + distance * ray
        placed.append((position, radius))
        spin = draw(vectors) * (U / radius) if spinning else np.zeros(3)
        bodies.append(
            {
                "position": _list(position),
                "velocity": _list((bulk + draw(vectors)) * U),
                "angular_velocity": _list(spin),
                "radius": radius,
                "mass": M if alike else M * draw(decades(-3, 3)),
                "inertia_factor": draw(choices(0.4, 0.4, 2 / 3, 0.05)),
            }
        )
    return bodies


def _clear(
    origin: FloatArray, ray: FloatArray, distance: float, radius: float, placed: list[tuple[FloatArray, float]]
) -> float:
    """Return the distance along a ray from which a sphere overlaps none of those placed."""
    blocked = []
    for centre, other in placed:
        along = float((centre - origin) @ ray)
        aside = centre - origin - along * ray  # not by Pythagoras, which would cancel where the other is far
        room = (radius + other) ** 2 - float(aside @ aside)
        if room > 0.0:
            blocked.append((along - math.sqrt(room), along + math.sqrt(room)))
    for entry, exit_ in sorted(blocked):  # by entry: once past an interval, none that begins before it is met again
        if entry < distance < exit_:
            distance = exit_
    return distance


def _box(bodies: list[Document], slack: float) -> list[float]:
    """Return a periodic box in which nothing overlaps: a slack of 0 lets the outermost touch through the wall."""
    position = np.array([body["position"] for body in bodies])
    radius = np.array([body["radius"] for body in bodies])[:, None]
    extent = (position + radius).max(axis=0) - (position - radius).min(axis=0)
    return _list(np.maximum(extent * (1.0 + slack), 4.0 * radius.max()))


def _timings(integrator: str) -> st.SearchStrategy[str]:
    """Yoshida's drifts go back in time, where no impact can be."""
    return choices("auto", "end-of-step", *(["time-of-impact"] if integrator != "yoshida4" else []))


@st.composite
def _time(draw: DrawFn, L: float, U: float, fixed: bool, velocity_limit: str | None) -> Document:
    T = L / U
    reach = draw(choices("auto", 0.001, 0.01, 0.1, 1.0))
    time: Document = {
        "duration": 1e9 * T,  # the tests count steps
        "integrator": draw(choices("euler", "leapfrog", "yoshida4")),
        "max_dt": T * draw(decades(-2, 1)),
        "target_dx": reach if reach == "auto" else L * reach,
        "cfl": draw(choices(0.05, 0.5, 1.0)),
        "smoothing": draw(choices(0.01, 0.2, 1.0)),
        "velocity_limit": velocity_limit or draw(choices("every-body", "fastest-body")),
    }
    if fixed:
        time["fixed_dt"] = 2.0 ** round(math.log2(T * draw(decades(-3, 0))))
    return time


@st.composite
def smooth_documents(draw: DrawFn, *, steps: int, integrators: tuple[str, ...]) -> Document:
    """Draw softened bodies that pull each other and pass through each other: nothing in their motion is sudden.

    The step is a part of 1/λ, λ² = 2 G M/ε³, so that a run of so many steps lasts at most half a time 1/λ. Plummer's
    force changes by at most G m/ε³ over a length, so two runs part no faster than exp(λ t) on their own account.
    """
    count = draw(_numbers(2, 8))
    L, M = draw(decades(-3, 4)), draw(decades(-3, 9))
    mass = [M * draw(decades(-3, 3)) for _ in range(count)]
    softening = L * draw(choices(0.25, 1.0))
    rate = 10.0 ** draw(_numbers(-3, 3))  # λ, 1/s
    constant = 0.5 * rate**2 * softening**3 / sum(mass)
    bodies = [
        {
            "position": _list(draw(vectors) * (4 * L)),
            "velocity": _list(draw(vectors) * (L * rate)),
            "angular_velocity": _list(draw(vectors) * (10 * rate)),
            "radius": 0.3 * L,
            "mass": m,
        }
        for m in mass
    ]
    return {
        "body": bodies,
        "time": {
            "duration": 1e9 / rate,
            "fixed_dt": draw(choices(0.1, 0.5)) / (steps * rate),
            "integrator": draw(choices(*integrators)),
        },
        "gravity": {
            "constant": constant,
            "softening": softening,
            "uniform": _list(draw(vectors) * (L * rate * rate)),
        },
        "contact": {"enabled": False},
        "record": {"every": "step", "check_every": 1},
    }


@st.composite
def impact_documents(draw: DrawFn) -> Document:
    """Draw pairs far from each other, each of which collides once, within the first six steps of 2⁻⁶ s.

    An impact is found at the end of the step in which it happens. Each happens in the middle of one, at 0.3 to 0.7,
    and at 17° or more from grazing, so that round-off does not move it to another step; and static and kinetic
    friction are equal, so that round-off at the edge of sliding changes nothing by a jump.
    """
    dt = 2.0**-6
    bodies: list[Document] = []
    for site in range(draw(_numbers(1, 4))):
        radii = [draw(decades(-1, 1)), draw(decades(-1, 1))]
        reach = sum(radii)
        normal = draw(directions)
        across = np.cross(normal, draw(directions))
        across = across / np.linalg.norm(across) if across.any() else across
        head_on = draw(choices(0.3, 0.6, 1.0))
        speed = draw(choices(0.02, 0.1, 0.2)) * reach / dt
        approach = speed * (-head_on * normal + math.sqrt(1.0 - head_on**2) * across)
        touching = (draw(_numbers(0, 5)) + draw(choices(0.3, 0.5, 0.7))) * dt  # s
        own = draw(vectors) * speed
        first = np.array([1000.0 * site, 0.0, 0.0]) + draw(vectors)
        for k in range(2):
            bodies.append(
                {
                    "position": _list(first + k * (reach * normal - touching * approach)),
                    "velocity": _list(own + k * approach),
                    "angular_velocity": _list(draw(vectors) * (speed / radii[k])),
                    "radius": radii[k],
                    "mass": draw(decades(-3, 3)),
                }
            )
    friction = draw(choices(0.0, 0.1, 0.5, 10.0))
    return {
        "body": bodies,
        "time": {"duration": 10.0, "fixed_dt": dt, "integrator": draw(choices("euler", "leapfrog"))},
        "gravity": {"constant": 0.0},
        "contact": {
            "restitution": draw(parts),
            "static_friction": friction,
            "kinetic_friction": friction,
            "stabilisation": draw(choices("split", "baumgarte", "none")),
            "timing": draw(_timings("leapfrog")),
            "colouring": draw(choices("contacts", "bodies")),
        },
        "record": {"every": "step", "check_every": 1},
    }


def _list(vector: FloatArray) -> list[float]:
    return [float(value) for value in vector]
