"""The bodies as a structure of arrays."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from carom.arrays import BoolArray, FloatArray
from carom.scene.start import InitialBodies


@dataclass(frozen=True, slots=True)
class Ends:
    """The possible ends of a contact: n bodies, then p planes and walls, whose velocities are 0 here.

    The arrays of `Bodies` are views of the first n rows.
    """

    velocity: FloatArray  # (n + p, 3) m/s, velocities
    acceleration: FloatArray  # (n + p, 3) m/s², accelerations
    angular_velocity: FloatArray  # (n + p, 3) rad/s, spins; (0, 3) if nothing spins
    inverse_mass: FloatArray  # (n + p,) 1/kg; 0 for planes and fixed bodies, infinite for test particles
    inverse_inertia: FloatArray  # (n + p,) 1/(kg m²); 0 for planes and fixed bodies, infinite for test particles
    radius: FloatArray  # (n + p,) m, radii; infinite for a plane


@dataclass(frozen=True, slots=True)
class Bodies:
    """State of n spheres; every array is C-contiguous float64 in SI units and is updated in place."""

    position: FloatArray  # (n, 3) m
    velocity: FloatArray  # (n, 3) m/s
    acceleration: FloatArray  # (n, 3) m/s², acceleration by all forces but drag
    orientation: FloatArray  # (n, 4) unit quaternions, xyzw; this array and the next three are empty if not required
    angular_velocity: FloatArray  # (n, 3) rad/s
    angular_acceleration: FloatArray  # (n, 3) rad/s², mean over the last step; empty if no torques are modelled
    torque: FloatArray  # (n, 3) N m, Σ r × J / dt over all contacts and impacts of the last step
    mass: FloatArray  # (n,) kg
    radius: FloatArray  # (n,) m
    inertia: FloatArray  # (n,) kg m²
    ends: Ends

    @classmethod
    def at_start(
        cls, start: InitialBodies, *, spins: bool = False, orients: bool = False, torques: bool = False, planes: int = 0
    ) -> Bodies:
        """Build the state at time 0; spins, orientations and torques take no memory if they are not required."""
        n = len(start.mass)
        turning = n if spins else 0
        orientation = np.zeros((n if orients else 0, 4))
        orientation[:, 3] = 1.0
        ends = Ends(
            velocity=_with_rows(start.velocity, planes),
            acceleration=np.zeros((n + planes, 3)),
            angular_velocity=_with_rows(start.angular_velocity[:turning], planes if spins else 0),
            inverse_mass=_with_rows(_inverse(start.mass, start.fixed), planes),
            inverse_inertia=_with_rows(_inverse(start.inertia, start.fixed), planes),
            radius=np.concatenate((start.radius, np.full(planes, np.inf))),
        )
        return cls(
            position=start.position.copy(),
            velocity=ends.velocity[:n],
            acceleration=ends.acceleration[:n],
            orientation=orientation,
            angular_velocity=ends.angular_velocity[:turning],
            angular_acceleration=np.zeros((n if torques else 0, 3)),
            torque=np.zeros((n if torques else 0, 3)),
            mass=start.mass.copy(),
            radius=ends.radius[:n],
            inertia=start.inertia.copy(),
            ends=ends,
        )

    def __len__(self) -> int:
        return len(self.mass)


def _inverse(mass: FloatArray, fixed: BoolArray) -> FloatArray:
    """Return 1/mass; 0 for fixed bodies."""
    with np.errstate(divide="ignore"):
        return np.where(fixed, 0.0, 1.0 / mass)


def _with_rows(array: FloatArray, rows: int) -> FloatArray:
    return np.concatenate((array, np.zeros((rows, *array.shape[1:]))))
