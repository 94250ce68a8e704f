"""REBOUND: particles that attract each other, and hard spheres."""

from __future__ import annotations

import ctypes
import math
from typing import Any

import numpy as np

from carom.arrays import Records
from carom.errors import RecordingError
from carom.recording.source.adapters.package import engine_package, named_version
from carom.recording.source.source import Model, State, StateMemory
from carom.scene.units.system import WITHOUT, units_of_rebound

G_SI = 6.674e-11  # m³ kg⁻¹ s⁻²; REBOUND's own differs in the fifth digit
READ = ("x", "y", "z", "vx", "vy", "vz")  # the first numbers of a particle in memory
ROW = np.dtype((np.void, 8 * len(READ)))  # all of them, copied as one: six times as fast as six numbers


class ReboundSource:
    """The particles of a simulation, in its ``units``; without any, in SI if its G is that of SI, or in no units.

    Parameters
    ----------
    simulation
        A rebound.Simulation. Particles cannot be added or removed while it is recorded.
    radius
        m, drawn for particles without a radius; by default a hundredth of their extent.
    """

    def __init__(self, simulation: Any, radius: float | None = None) -> None:
        self._stride = _size_of(engine_package("rebound").Particle)
        self._simulation = simulation
        self._all, self._n = simulation.N, simulation.N - _variational(simulation)
        self._address, self._particles = 0, np.empty(0, ROW)  # a view of the particles in memory
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
            units=_units(simulation),
        )

    def state(self) -> State:
        """Return positions and velocities of the particles."""
        snapshot = self.memory()
        self.read(snapshot)
        return snapshot.state

    def memory(self) -> StateMemory:
        """Return memory for one state; see `BulkSource`."""
        block = np.empty((self._n, len(READ)))
        return StateMemory(State(0.0, block[:, :3], block[:, 3:]), block, (block.view(ROW)[:, 0],))

    def read(self, into: StateMemory) -> None:
        """Copy positions and velocities from REBOUND's own memory, in one pass."""
        simulation = self._simulation
        if self._all != simulation.N:
            raise RecordingError(
                f"rebound had {self._all} particles and has {simulation.N}: "
                "a recording keeps its bodies; begin another one"
            )
        if not simulation.is_synchronized:
            simulation.synchronize()
        address = ctypes.addressof(simulation._particles.contents)  # `simulation.particles` makes objects
        if address != self._address:
            self._address, self._particles = address, _particles_at(address, self._stride, self._n)
        into.parts[0][:] = self._particles
        into.state.time = simulation.t


def rebound(simulation: Any, radius: float | None = None) -> ReboundSource:
    """Return the source of a rebound.Simulation; see `Rebound`."""
    return ReboundSource(simulation, radius)


def _variational(simulation: Any) -> int:
    """Return the number of variational particles among the N: none if these have their own array, as in 5.2."""
    return 0 if hasattr(simulation, "particles_var") else int(getattr(simulation, "N_var", 0))


def _setting(simulation: Any, name: str) -> str:
    value = getattr(simulation, name, "none")
    return value if isinstance(value, str) else str(getattr(value, "name", value)).lower()


def _units(simulation: Any) -> str:
    """Return the units that were set for the simulation; without any, SI if its G has the value of SI."""
    without = "" if math.isclose(simulation.G, G_SI, rel_tol=1e-3) else WITHOUT
    return units_of_rebound(simulation.units) or without


def _box(simulation: Any) -> Any:
    return np.array([simulation.N_root_x, simulation.N_root_y, simulation.N_root_z]) * simulation.root_size


def _name(particle: Any, number: int) -> str:
    return str(getattr(particle, "name", None) or f"body {number}")


def _size_of(particle: Any) -> int:
    """Return the bytes of a particle; refuse a version with another layout of particles in memory."""
    if [getattr(particle, name).offset for name in READ] != [8 * k for k in range(len(READ))]:
        raise RecordingError(f"{named_version('rebound')} keeps its particles in another order; carom knows 5.x")
    return ctypes.sizeof(particle)


def _particles_at(address: int, size: int, count: int) -> Records:
    """Return a view of the positions and velocities of particles of some bytes each, (n,) rows."""
    raw = (ctypes.c_char * (size * count)).from_address(address)
    return np.ndarray((count,), ROW, memoryview(raw), strides=(size,))
