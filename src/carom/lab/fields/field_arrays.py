"""Fields on a grid, as arrays."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from carom.arrays import FloatArray
from carom.scene.units.system import UnitSystem

UNITS: Mapping[str, str] = {  # units of the arrays of `Fields`, by name
    "number_density": "1/m³",
    "solid_fraction": "",
    "density": "kg/m³",
    "velocity": "m/s",
    "granular_temperature": "J",
    "kinetic_stress": "Pa",
    "contact_stress": "Pa",
    "pressure": "Pa",
    "coordination": "",
}


@dataclass(frozen=True)
class Fields:
    """Means over an interval in the cells of a grid, in the units of the recording; see docs/physics.md, section 13.

    Arrays have the shape (nx, ny, nz); vectors and tensors have further axes for their components. In a cell without
    bodies, velocity, temperature and coordination are NaN, like all values that the recording lacks.
    """

    title: str
    units: UnitSystem
    start: float  # s, time of the first frame of the interval
    end: float  # s, time of the last frame of the interval
    moments: int  # number of exact states over which bodies and lasting contacts are averaged
    bodies: int  # number of movable bodies; fixed ones are boundaries, like walls
    origin: FloatArray  # (3,) m, the corner of the grid with the lowest coordinates
    cell: FloatArray  # (3,) m, edges of each cell
    number_density: FloatArray  # 1/m³
    solid_fraction: FloatArray  # a body's whole volume counts in the cell of its centre
    density: FloatArray  # kg/m³
    velocity: FloatArray  # m/s, momentum divided by mass
    granular_temperature: FloatArray  # J, ⟨m c²⟩/3, with c relative to `velocity`
    kinetic_stress: FloatArray  # (…, 3, 3) Pa, momentum flux of moving bodies; compression is positive
    # (…, 3, 3) Pa, flux of momentum (second index) through contacts, in the direction of the first index
    contact_stress: FloatArray
    coordination: FloatArray  # lasting contacts per body; a contact of two bodies counts for both
    notes: Sequence[str] = ()  # sentences about data that the recording lacks

    @property
    def shape(self) -> tuple[int, int, int]:
        """Number of cells along x, y and z."""
        x, y, z = self.density.shape
        return x, y, z

    @property
    def pressure(self) -> FloatArray:
        """A third of the trace of both stresses, Pa."""
        return np.asarray(np.trace(self.kinetic_stress + self.contact_stress, axis1=3, axis2=4) / 3.0)

    @property
    def arrays(self) -> dict[str, FloatArray]:
        """All fields by their names; see `UNITS`."""
        return {name: getattr(self, name) for name in UNITS}

    def faces(self, axis: int) -> FloatArray:
        """Return the coordinates (m) of the faces between cells along an axis."""
        return np.asarray(self.origin[axis] + self.cell[axis] * np.arange(self.shape[axis] + 1))
