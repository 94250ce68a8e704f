"""Small scenes that several tests share."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from carom.physics.bodies import Bodies
from carom.physics.contact.graph import colour_contacts, solve_order_of
from carom.physics.contact.law import materials_of
from carom.physics.contact.solver.contact_solver import ContactSolver
from carom.physics.jit.team import Team
from carom.scene.load import Scene
from carom.scene.matter import PairCoefficients
from carom.scene.scene_file import bundled_scenes
from carom.scene.schema.contact import Sweeps
from carom.scene.start import HalfSpaces, InitialBodies

FloatArray = NDArray[np.float64]


NIGHTLY = ("dense-shear", "hopper")  # bundled scenes that take a minute each
SLOW_MARKS = (pytest.mark.slow,)
NIGHTLY_MARKS = (pytest.mark.slow, pytest.mark.nightly)


def walls_as_slow(names: Iterable[str]) -> list[Any]:
    """Return scenes as parameters; those with walls, motions, pistons or shear, which compile for long, are slow."""
    texts = {name: path.read_text(encoding="utf-8") for name, path in bundled_scenes().items()}
    parts = "[[wall]]", "motion = ", "piston = ", "shear = "
    walled = {name for name, text in texts.items() if any(part in text for part in parts)}
    return [pytest.param(name, marks=_marks_of(name) if name in walled else ()) for name in names]


def bundled(quick: tuple[str, ...]) -> list[Any]:
    """Return the bundled scenes as parameters, of which all but the quick ones are slow."""
    return [pytest.param(name, marks=() if name in quick else _marks_of(name)) for name in bundled_scenes()]


def _marks_of(name: str) -> tuple[pytest.MarkDecorator, ...]:
    return NIGHTLY_MARKS if name in NIGHTLY else SLOW_MARKS


def scene_of(bodies: list[dict[str, Any]], **sections: Any) -> Scene:
    """Build a scene of explicit bodies in which every step is recorded and checked, unless told otherwise."""
    sections.setdefault("record", {"every": "step", "check_every": 1})
    return Scene.from_dict({"body": bodies, **sections})


def pair(speed: float = 1.0, offset: float = 0.0, **sections: Any) -> Scene:
    """Build two equal spheres of radius 1 m and mass 1 kg that approach each other along x, without gravity."""
    sections.setdefault("gravity", {"constant": 0.0})
    left = {"position": [-2.0, 0.0, 0.0], "velocity": [speed, 0.0, 0.0], "mass": 1.0}
    right = {"position": [2.0, offset, 0.0], "velocity": [-speed, 0.0, 0.0], "mass": 1.0}
    return scene_of([left, right], **sections)


def cloud(count: int = 40, **sections: Any) -> Scene:
    """Build a dense cloud of unequal, spinning bodies that collapses within seconds, friction and all."""
    document = {
        "seed": 4,
        "time": {"duration": 3.0, "max_dt": 0.02, "cfl": 0.1},
        "gravity": {"constant": 1.0},
        "record": {"every": "step", "check_every": 1},
        "group": [
            {
                "count": count,
                "radius": {"min": 0.2, "max": 0.5},
                "density": 3.0,
                "region": {"shape": "ball", "radius": 3.0},
                "velocity": {"dispersion": 0.3},
                "spin": {"dispersion": 1.0},
            }
        ],
    }
    for name, section in sections.items():
        document[name] = {**document.get(name, {}), **section} if isinstance(section, dict) else section  # type: ignore[dict-item]
    return Scene.from_dict(document)


def random_bodies(count: int, seed: int, spins: bool = True) -> Bodies:
    """Build bodies of unequal size and mass in random motion, some of them overlapping."""
    rng = np.random.default_rng(seed)
    radius = rng.uniform(0.3, 1.0, count)
    mass = rng.uniform(0.5, 4.0, count)
    start = InitialBodies(
        name=[""] * count,
        group=np.zeros(count, dtype=np.int64),
        position=rng.uniform(-1, 1, (count, 3)) * 0.8 * count ** (1 / 3),
        velocity=rng.standard_normal((count, 3)),
        angular_velocity=rng.standard_normal((count, 3)),
        mass=mass,
        radius=radius,
        inertia=0.4 * mass * radius**2,
        fixed=np.zeros(count, dtype=bool),
    )
    return Bodies.at_start(start, spins=spins, orients=spins, torques=spins)


def solver_of(
    bodies: Bodies,
    pairs: NDArray[np.int64],
    law: list[float] | PairCoefficients,
    box: FloatArray | None = None,
    threads: int = 1,
    sweeps: Sweeps = "auto",
    records: bool = False,
) -> ContactSolver:
    """Give contacts of bodies alone to a solver, given restitution, static and kinetic friction of all or of pairs."""
    no_planes = HalfSpaces([], np.empty((0, 3)), np.empty(0))
    box = np.zeros(3) if box is None else box
    spins = len(bodies.orientation) > 0
    laws = law if isinstance(law, PairCoefficients) else PairCoefficients(np.array([law]), len(bodies))
    materials, team = materials_of(laws), Team(threads)
    solver = ContactSolver(bodies, no_planes, materials, box, spins, team, records=records, sweeps=sweeps)
    solver.lay(solve_order_of(pairs, colour_contacts(pairs, bodies.ends.inverse_mass)))
    return solver


def momentum_of(bodies: Bodies) -> FloatArray:
    """Σ m v."""
    return np.asarray(bodies.mass @ bodies.velocity)


def angular_momentum_of(bodies: Bodies) -> FloatArray:
    """Σ (m x × v + I ω)."""
    orbital = bodies.mass[:, None] * np.cross(bodies.position, bodies.velocity)
    spin = bodies.inertia[:, None] * bodies.angular_velocity if len(bodies.angular_velocity) else np.zeros((1, 3))
    return np.asarray(orbital.sum(axis=0) + spin.sum(axis=0))


def kinetic_energy_of(bodies: Bodies) -> float:
    """Σ ½ m v² + Σ ½ I ω²."""
    energy = 0.5 * bodies.mass @ np.sum(bodies.velocity**2, axis=1)
    if len(bodies.angular_velocity):
        energy += 0.5 * bodies.inertia @ np.sum(bodies.angular_velocity**2, axis=1)
    return float(energy)


def two_planets() -> Scene:
    """Return 60 s of two planets for which "auto" takes wisdom-holman where the scene lasts 6300 s or more."""
    bodies: list[dict[str, Any]] = [
        {"mass": 1.0, "radius": 1e-6},
        {"mass": 1e-6, "radius": 1e-6, "position": [1.0, 0.0, 0.0], "velocity": [0.0, 1.0, 0.0]},
        {"mass": 1e-6, "radius": 1e-6, "position": [0.0, 4.0, 0.0], "velocity": [-0.5, 0.0, 0.0]},
    ]
    sections = {"time": {"duration": 60.0, "max_dt": 1e3}, "gravity": {"constant": 1.0}, "record": {"every": "auto"}}
    return scene_of(bodies, contact={"enabled": False}, **sections)
