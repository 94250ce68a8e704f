"""Gases of equal hard spheres in a periodic box: how they start, and what kinetic theory says of them.

Units: diameter 1 m, mass 1 kg, and a temperature of 1, which is the variance of each component of the velocity (m²/s²).
"""

from __future__ import annotations

from dataclasses import dataclass
from math import pi, sqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray

from carom.physics.space import Space
from carom.scene.load import Scene
from carom.state.frame import CollisionGraph

FloatArray = NDArray[np.float64]

DIAMETER = 1.0  # m
MASS = 1.0  # kg
INERTIA = 0.4 * MASS * (DIAMETER / 2) ** 2  # kg m²
FOR_EVER = 1e30  # s


def carnahan_starling(packing: float) -> float:
    """Compressibility factor p/(n T) of hard spheres (Carnahan & Starling, J. Chem. Phys. 51, 635, 1969)."""
    return (1 + packing + packing**2 - packing**3) / (1 - packing) ** 3


def enskog_rate(packing: float, temperature: float = 1.0) -> float:
    """Collisions of one sphere in a second, 4 n σ² g √(πT/m), with g at contact of Carnahan & Starling."""
    number_density = packing * 6 / (pi * DIAMETER**3)
    contact_value = (1 - packing / 2) / (1 - packing) ** 3
    return 4 * number_density * DIAMETER**2 * contact_value * sqrt(pi * temperature / MASS)


def gas(cells: int, packing: float, seed: int, spin_temperature: float = 0.0, **sections: Any) -> Space:
    """Put 4 cells³ spheres on a face-centred cubic lattice, which melts, with Maxwellian velocities.

    The centre of mass rests and the temperature is exactly 1. Random placement would end at a packing of 0.38.
    """
    random = np.random.default_rng(seed)
    corners = np.stack(np.meshgrid(*[np.arange(cells)] * 3, indexing="ij"), axis=-1).reshape(-1, 1, 3)
    basis = np.array([[0.0, 0.0, 0.0], [0.5, 0.5, 0.0], [0.5, 0.0, 0.5], [0.0, 0.5, 0.5]])
    count = 4 * cells**3
    size = (count * pi / 6 * DIAMETER**3 / packing) ** (1 / 3)
    position = ((corners + basis + 0.25) / cells - 0.5).reshape(-1, 3) * size
    velocity = random.standard_normal((count, 3))
    velocity -= velocity.mean(axis=0)
    velocity /= sqrt(np.mean(velocity**2))
    spin = random.standard_normal((count, 3)) * sqrt(spin_temperature / INERTIA)
    return Space(
        Scene.from_dict(
            {
                "gravity": {"constant": 0.0},
                "domain": {"boundary": "periodic", "size": [size] * 3},
                "record": {"check_every": 1_000_000},
                "body": [
                    {"radius": DIAMETER / 2, "mass": MASS, "position": x, "velocity": v, "angular_velocity": w}
                    for x, v, w in zip(position.tolist(), velocity.tolist(), spin.tolist(), strict=True)
                ],
                **sections,
                "time": {"duration": FOR_EVER, "max_dt": FOR_EVER, **sections.get("time", {})},
            }
        ),
        threads=1,
    )


def temperature(space: Space) -> float:
    """Translational temperature, ⅓ ⟨v²⟩ about the centre of mass."""
    velocity = space.state.velocity
    return float(np.mean((velocity - velocity.mean(axis=0)) ** 2)) * MASS


def rotational_temperature(space: Space) -> float:
    """Rotational temperature, ⅓ I ⟨ω²⟩."""
    return float(np.mean(space.state.angular_velocity**2)) * INERTIA


def collisions_per_sphere(space: Space) -> float:
    """Collisions of one sphere so far; each is shared by two."""
    return 2 * space.extremes.impacts / len(space.state)


def normal_impulses(contacts: CollisionGraph, change: FloatArray) -> FloatArray:
    """Find the impulse of each frictionless contact of a step, (m,) N s, from the changes of velocity, (n, 3) m/s.

    Between steps nothing but impacts changes a velocity, so m Δv = Σ ± J n. The normals of a cluster that is no ring
    are independent, and the least squares then are the solution.
    """
    bodies, ends = np.unique(contacts.pairs, return_inverse=True)
    ends = ends.reshape(-1, 2)
    m = len(contacts)
    matrix = np.zeros((len(bodies), 3, m))
    matrix[ends[:, 0], :, np.arange(m)] = -contacts.normals
    matrix[ends[:, 1], :, np.arange(m)] = contacts.normals
    momentum = MASS * change[bodies].ravel()
    return np.asarray(np.linalg.lstsq(matrix.reshape(-1, m), momentum, rcond=None)[0])


@dataclass(frozen=True)
class Equilibrium:
    """What an elastic gas measured: compressibility factor, collisions of a sphere a second, and of all in the run."""

    compressibility: float
    rate: float
    collisions: int


def measure_equilibrium(
    packing: float, dt: float, collisions: int, cells: int = 8, melting: float = 20.0, seed: int = 1
) -> Equilibrium:
    """Let a lattice melt for some collisions a sphere, then add up Σ d·J, the virial of the collisions.

    With kinetic energy constant, Z = 1 + Σ d·J / (3 N T t). The distance d is that at which carom resolves the impact,
    a little below the diameter: Z is the pressure of the gas that carom simulates.
    """
    late = {"restitution": 1.0, "static_friction": 0.0, "timing": "end-of-step"}
    space = gas(cells, packing, seed, contact=late, time={"fixed_dt": dt})
    step = 0
    while collisions_per_sphere(space) < melting:
        step += 1
        space.compute_dynamics(step)
    begin, before, virial = space.time, space.extremes.impacts, 0.0
    while space.extremes.impacts - before < collisions:
        step += 1
        velocity = space.state.velocity.copy()
        space.compute_dynamics(step)
        if len(space.contacts):
            impulses = normal_impulses(space.contacts, space.state.velocity - velocity)
            virial += float(impulses @ (DIAMETER - space.contacts.overlaps))
    count, elapsed, counted = len(space.state), space.time - begin, space.extremes.impacts - before
    return Equilibrium(
        compressibility=1 + virial / (3 * count * temperature(space) * elapsed),
        rate=2 * counted / count / elapsed,
        collisions=counted,
    )


def cooling(
    restitution: float, packing: float, cells: int, cfl: float, until: float, seed: int
) -> tuple[FloatArray, FloatArray, float]:
    """Let a smooth inelastic gas cool by late impacts; return times, temperatures and Haff's τ, all times in seconds.

    Parameters
    ----------
    until
        Time to cool, in τ.
    """
    late = {"restitution": restitution, "static_friction": 0.0, "timing": "end-of-step"}
    space = gas(cells, packing, seed, contact=late, time={"cfl": cfl})
    tau = 6 / ((1 - restitution**2) * enskog_rate(packing))
    times, temperatures = [0.0], [1.0]
    step = 0
    while space.time < until * tau:
        step += 1
        space.compute_dynamics(step)
        times.append(space.time)
        temperatures.append(temperature(space))
    return np.array(times), np.array(temperatures), tau


def rough_ratio(restitution: float, spin_temperature: float, until: float, seed: int) -> FloatArray:
    """Let 500 rough spheres that always stick cool; return rows of (collisions of a sphere, T_rot / T_tr).

    A packing of 0.02 and 500 bodies make a box of 4 mean free paths: too small for the vortices that a larger gas of
    such lossy spheres falls into (Goldhirsch & Zanetti 1993), and thin enough for spheres to forget whom they met.
    Impacts are where they happen: found at the end of a step, overlapping, their lever arms are too short. Between them
    flight is free, so that the fastest may go three radii in a step.
    """
    sticking = 1e9  # a static friction that no impact exceeds
    contact = {"restitution": restitution, "static_friction": sticking, "kinetic_friction": sticking}
    space = gas(5, 0.02, seed, spin_temperature, contact=contact | {"timing": "time-of-impact"}, time={"cfl": 3.0})
    rows = [(0.0, rotational_temperature(space) / temperature(space))]
    step = 0
    while rows[-1][0] < until:
        step += 1
        space.compute_dynamics(step)
        if collisions_per_sphere(space) >= rows[-1][0] + 0.5:
            rows.append((collisions_per_sphere(space), rotational_temperature(space) / temperature(space)))
    return np.array(rows)
