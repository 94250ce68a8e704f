"""REBOUND: particles that pull each other, and hard spheres."""

from __future__ import annotations

from typing import Any

import numpy as np

from carom.recording.errors import RecordingError
from carom.recording.source.adapters.package import engine_package, named_version
from carom.recording.source.source import Model, State


class Rebound:
    """The particles of a simulation, in its units: with ``G = 1`` they are not SI, and neither is what is printed.

    Parameters
    ----------
    simulation
        A rebound.Simulation. Particles cannot be added or removed while it is recorded.
    radius
        m, drawn for particles without a radius; by default a hundredth of their extent.
    """

    def __init__(self, simulation: Any, radius: float | None = None) -> None:
        engine_package("rebound")
        self._simulation = simulation
        self._n = simulation.N - _variational(simulation)
        self._state = np.zeros((simulation.N, 6))  # positions and velocities
        mass, size = np.zeros(simulation.N), np.zeros(simulation.N)
        simulation.serialize_particle_data(m=mass, r=size)
        mass, size = mass[: self._n], size[: self._n]
        touches = _setting(simulation, "collision") != "none" and bool((size > 0.0).all())
        if radius is not None:
            size = np.where(size > 0.0, size, radius)
        particles = [simulation.particles[k] for k in range(self._n)]
        pulls = _setting(simulation, "gravity") != "none"
        periodic = _setting(simulation, "boundary") in ("periodic", "shear")
        self.model = Model(
            engine=named_version("rebound"),
            mass=mass,
            radius=size,
            names=[_name(particle, k) for k, particle in enumerate(particles)],
            constant=simulation.G if pulls else 0.0,
            softening=simulation.softening,
            box=_box(simulation) if periodic else None,
            collides=touches,
            time_step=abs(simulation.dt),
        )

    def state(self) -> State:
        """Return positions and velocities of the particles."""
        simulation = self._simulation
        known = len(self._state)
        if known != simulation.N:
            raise RecordingError(
                f"rebound had {known} particles and has {simulation.N}: a recording keeps its bodies; begin another one"
            )
        simulation.synchronize()
        simulation.serialize_particle_data(xyzvxvyvz=self._state)
        return State(simulation.t, self._state[: self._n, :3], self._state[: self._n, 3:])


def rebound(simulation: Any, radius: float | None = None) -> Rebound:
    """Return the source of a rebound.Simulation; see `Rebound`."""
    return Rebound(simulation, radius)


def _variational(simulation: Any) -> int:
    return int(getattr(simulation, "N_var", 0))


def _setting(simulation: Any, name: str) -> str:
    value = getattr(simulation, name, "none")
    return value if isinstance(value, str) else str(getattr(value, "name", value)).lower()


def _box(simulation: Any) -> Any:
    return np.array([simulation.N_root_x, simulation.N_root_y, simulation.N_root_z]) * simulation.root_size


def _name(particle: Any, number: int) -> str:
    return str(getattr(particle, "name", None) or f"body {number}")
