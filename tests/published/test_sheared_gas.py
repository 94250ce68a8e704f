"""A granular gas under uniform shear: temperature and stress of the kinetic theory of smooth, inelastic spheres.

Lun, Savage, Jeffrey & Chepurniy, J. Fluid Mech. 140, 223 (1984): with η = (1 + e)/2, the packing fraction ν, the value
g₀ of the pair correlation at contact (Carnahan & Starling 1969), the diameter d and the density ρ of a sphere,

    viscosity      μ = ρ d √T g₂,   g₂ = 5√π/96 [1/(η(2 - η) g₀) + (8/5)(3η - 1)/(2 - η) ν
                                                 + (64/25) η ((3η - 2)/(2 - η) + 12/π) ν² g₀]
    dissipation    Γ = ρ T^(3/2)/d (48/√π) η(1 - η) ν² g₀

A steady flow at the rate γ dissipates the work of the stress, μ γ² = Γ, which gives T/(γ d)² and the shear stress
τ = μ γ. The theory is of first order in γ d/√T and neglects correlations of velocities.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from math import pi, sqrt
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import carom
from carom.errors import RecordingError
from carom.lab.statistics import Interval
from carom.lab.statistics.motion_statistics import measure_free_paths, measure_stress
from carom.lab.statistics.structure_statistics import measure_pair_correlation
from carom.physics.placement.initial_state import place
from carom.physics.space import Space
from carom.scene.load import Scene

pytestmark = pytest.mark.slow  # seconds each


def theory(packing: float, restitution: float) -> tuple[float, float]:
    """Return T/(γ d)² and τ/(ρ γ² d²)."""
    eta, contact = 0.5 * (1 + restitution), (1 - packing / 2) / (1 - packing) ** 3
    kinetic = 1 / (eta * (2 - eta) * contact) + 1.6 * (3 * eta - 1) / (2 - eta) * packing
    viscosity = kinetic + 2.56 * eta * ((3 * eta - 2) / (2 - eta) + 12 / pi) * packing**2 * contact
    viscosity *= 5 * sqrt(pi) / 96
    temperature = viscosity * sqrt(pi) / (48 * eta * (1 - eta) * packing**2 * contact)
    return temperature, viscosity * sqrt(temperature)


def sheared_gas(packing: float, restitution: float, count: int, duration: float) -> dict[str, Any]:
    """Return spheres of d = 1 m and ρ = 1 kg/m³ in a cube at γ = 1/s, at the temperature of the theory."""
    size = [(count * pi / 6 / packing) ** (1 / 3)] * 3
    spheres = {
        "count": count,
        "radius": 0.5,
        "density": 1.0,
        "region": {"shape": "box", "size": size},
        "arrangement": "random" if packing < 0.25 else "compressed",
        "velocity": {"dispersion": sqrt(theory(packing, restitution)[0])},
    }
    return {
        "seed": 1,
        "time": {"duration": duration},
        "gravity": {"constant": 0.0},
        "contact": {"restitution": restitution, "static_friction": 0.0},
        "domain": {"boundary": "periodic", "size": size, "shear": {"rate": 1.0}},
        "record": {"every": 0.5},
        "group": [spheres],
    }


@dataclass(frozen=True)
class Steady:
    """The steady state of a sheared gas."""

    temperature: float  # m²/s²
    stress: float  # Pa, the work of the shear over γ, time and volume


@cache
def steady(packing: float, restitution: float, count: int) -> Steady:
    """Average from 10 to 40 s; the mean velocity is 0 at the start, since it would drift along the flow."""
    document = sheared_gas(packing, restitution, count, 40.0)
    scene = Scene.from_dict(document)
    start = place(scene)
    flow = np.outer(start.position[:, 1], [1.0, 0.0, 0.0])
    start = replace(start, velocity=start.velocity - (start.velocity - flow).mean(axis=0))
    temperatures, work, times = [], [], []
    for frame in Space(scene, start=start).run():
        if frame.time >= 10.0:
            relative = frame.velocity - np.outer(frame.position[:, 1], [1.0, 0.0, 0.0])
            temperatures.append(float(np.mean((relative - relative.mean(axis=0)) ** 2)))
            work.append(-frame.energy.ledger.entry("shear"))
            times.append(frame.time)
    volume = np.prod(document["domain"]["size"])
    return Steady(float(np.mean(temperatures)), float((work[-1] - work[0]) / (times[-1] - times[0]) / volume))


@pytest.mark.parametrize(
    ("packing", "restitution", "of_temperature", "of_stress"),
    [
        # (γ d)²/T is 0.1. Four seeds: T 1.000 ± 0.007 and τ 1.023 ± 0.015 of the theory; three standard deviations
        pytest.param(0.2, 0.98, 0.03, 0.07, marks=pytest.mark.nightly),
        # (γ d)²/T is 0.5, 0.9 and 1.1, beyond the first order in the gradient: T is lower by 5 to 6 % (four seeds at
        # 0.2: T 0.941 ± 0.008, τ 0.973 ± 0.006; at 0.4: 0.953 ± 0.004, 1.026 ± 0.010)
        pytest.param(0.2, 0.9, 0.08, 0.05, marks=pytest.mark.nightly),
        pytest.param(0.3, 0.9, 0.08, 0.05, marks=pytest.mark.nightly),
        (0.4, 0.9, 0.08, 0.06),
    ],
)
def test_temperature_and_shear_stress_are_those_of_kinetic_theory(
    packing: float, restitution: float, of_temperature: float, of_stress: float
) -> None:
    measured, (temperature, stress) = steady(packing, restitution, 500), theory(packing, restitution)
    assert measured.temperature == pytest.approx(temperature, rel=of_temperature)
    assert measured.stress == pytest.approx(stress, rel=of_stress)


def test_the_viscosity_does_not_depend_on_the_size_of_the_box() -> None:
    # both fluctuate by 1 % in the mean; below some nine diameters (256 spheres), T would be lower by 5 %
    small, large = steady(0.2, 0.9, 500), steady(0.2, 0.9, 1500)
    assert small.temperature == pytest.approx(large.temperature, rel=0.03)
    assert small.stress / sqrt(small.temperature) == pytest.approx(large.stress / sqrt(large.temperature), rel=0.03)


def test_the_recorded_stress_tensor_does_the_work_that_the_ledger_books(tmp_path: Path) -> None:
    document = sheared_gas(0.2, 0.9, 500, 16.0)
    scene = Scene.from_dict(document | {"record": {"every": 0.25, "impacts": "all"}})
    recording = carom.run(scene, tmp_path / "gas.rrd")
    energy = recording.energy()
    work, time = energy["shear"].to_numpy(), energy["time"].to_numpy()
    supplied = -(work[-1] - work[0]) / (time[-1] - time[0]) / np.prod(document["domain"]["size"])
    interval = Interval.of(recording, None, None, False, lambda _: None)
    stress = np.asarray(measure_stress(interval).values["stress"].value)
    # impacts are exact; the kinetic part is known at 64 moments (1.5 %). The work also changes Σ m (c_x γ y + γ² y²/2),
    # which fluctuates by 100 J, 2 % of the work
    assert -stress[0, 1] == pytest.approx(supplied, rel=0.06)
    for measure in (measure_free_paths, measure_pair_correlation):
        with pytest.raises(RecordingError, match="in a sheared box cannot be measured yet"):
            measure(interval)
    assert stress[0, 1] == pytest.approx(stress[1, 0], rel=1e-12)
    assert abs(stress[0, 2]) + abs(stress[1, 2]) < 0.1 * abs(stress[0, 1])
