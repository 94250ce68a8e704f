"""The API of the reference engine: one body and one collision, in vector form.

Its functions ``compute_dynamics`` and ``get_body_data_for_display`` are methods of `carom.physics.space.Space`.
`CollisionContext` resolves a pair like `contact.solver.impacts.resolve_impacts`, but in readable form; tests compare
the two:

    v_n = (v_j - v_i)·n                              normal velocity, negative on approach
    J_n = max(0, -(1 + e) v_n + bias) / (1/m_i + 1/m_j)
    u_t = (v_j - v_i) - v_n n - (ρ_i ω_i + ρ_j ω_j) × n     slip at the contact point
    J_t = |u_t| / (1/m_i + 1/m_j + ρ_i²/I_i + ρ_j²/I_j)     if that is at most μ_s J_n, otherwise μ_k J_n

Both bodies share one contact point on the line of centres, at ρ_i = d r_i/(r_i + r_j) from i and ρ_j = d - ρ_i from j.
The lever arms r_i and r_j of overlapping spheres would not add up to d, so each friction impulse would create the
angular momentum overlap × J_t.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from carom.arrays import FloatArray
from carom.physics.bodies import Bodies


class BodyProxy:
    """A view of one body, which reads and writes the arrays."""

    __slots__ = ("_bodies", "index")

    def __init__(self, bodies: Bodies, index: int) -> None:
        self._bodies = bodies
        self.index = index

    @property
    def position(self) -> FloatArray:
        """Position of the centre, (3,) m."""
        return self._row(self._bodies.position)

    @property
    def velocity(self) -> FloatArray:
        """Velocity, (3,) m/s."""
        return self._row(self._bodies.velocity)

    @property
    def angular_velocity(self) -> FloatArray:
        """Angular velocity, (3,) rad/s; unused zeros if the scene requires no spin."""
        return self._row(self._bodies.angular_velocity) if self.spins else np.zeros(3)

    @property
    def orientation(self) -> FloatArray:
        """Orientation as a quaternion, (4,) xyzw."""
        orientations = self._bodies.orientation
        return self._row(orientations) if len(orientations) else np.array([0.0, 0.0, 0.0, 1.0])

    @property
    def mass(self) -> float:
        """Mass in kg."""
        return float(self._bodies.mass[self.index])

    @property
    def radius(self) -> float:
        """Radius in m."""
        return float(self._bodies.radius[self.index])

    @property
    def inertia(self) -> float:
        """Moment of inertia in kg m²."""
        return float(self._bodies.inertia[self.index])

    @property
    def inverse_mass(self) -> float:
        """Inverse mass in 1/kg; 0 for a fixed body."""
        return float(self._bodies.ends.inverse_mass[self.index])

    @property
    def inverse_inertia(self) -> float:
        """Inverse moment of inertia in 1/(kg m²); 0 for a fixed body."""
        return float(self._bodies.ends.inverse_inertia[self.index])

    @property
    def spins(self) -> bool:
        """Whether the scene requires spin."""
        return len(self._bodies.angular_velocity) > 0

    def apply_impulse(self, impulse: FloatArray, arm: FloatArray) -> None:
        """Apply an impulse at a point of the body.

        Δv = J / m, Δω = I⁻¹ (r × J).

        Parameters
        ----------
        impulse
            (3,) N s.
        arm
            (3,) m, from the centre to the point.
        """
        self.velocity[:] += impulse * self.inverse_mass
        if self.spins:
            self.angular_velocity[:] += np.cross(arm, impulse) * self.inverse_inertia

    def _row(self, array: FloatArray) -> FloatArray:
        row: FloatArray = array[self.index]
        return row


@dataclass(frozen=True)
class CollisionContext:
    """The data for resolving one collision."""

    b1: BodyProxy
    b2: BodyProxy
    n_vec: FloatArray  # (3,) unit vector from b1 to b2
    r1_vec: FloatArray  # (3,) m, from the centre of b1 to the contact point
    r2_vec: FloatArray  # (3,) m, from the centre of b2 to the contact point
    v_rel: FloatArray  # (3,) m/s, velocity of b2's contact point relative to b1's contact point
    overlap: float  # m

    @classmethod
    def from_bodies(cls, b1: BodyProxy, b2: BodyProxy) -> CollisionContext | None:
        """Describe the collision of two bodies in open space; None if they do not touch."""
        separation = b2.position - b1.position
        distance = float(np.sqrt(separation @ separation))
        reach = b1.radius + b2.radius
        if distance > reach:
            return None
        n_vec = separation / distance if distance > 0.0 else np.array([1.0, 0.0, 0.0])
        r1_vec = n_vec * (distance * b1.radius / reach)
        r2_vec = -n_vec * (distance * b2.radius / reach)
        v1 = b1.velocity + np.cross(b1.angular_velocity, r1_vec)
        v2 = b2.velocity + np.cross(b2.angular_velocity, r2_vec)
        return cls(b1, b2, n_vec, r1_vec, r2_vec, v2 - v1, reach - distance)

    def resolve(
        self, restitution: float, static_friction: float, kinetic_friction: float, *, bias: float = 0.0
    ) -> None:
        """Apply the normal impulse and the friction impulse to both bodies.

        Parameters
        ----------
        bias
            m/s, extra separation speed (Baumgarte).
        """
        b1, b2, n = self.b1, self.b2, self.n_vec
        inverse_mass = b1.inverse_mass + b2.inverse_mass
        if inverse_mass == 0.0:  # two fixed bodies
            return
        normal_speed = float(self.v_rel @ n)
        normal = max(0.0, -(1.0 + restitution) * normal_speed + bias) / inverse_mass
        slip = self.v_rel - normal_speed * n
        slip_speed = float(np.sqrt(slip @ slip))
        impulse = normal * n
        if slip_speed > 0.0 and b1.spins:
            turning = self.r1_vec @ self.r1_vec * b1.inverse_inertia + self.r2_vec @ self.r2_vec * b2.inverse_inertia
            sticking = slip_speed / (inverse_mass + turning)
            tangential = sticking if sticking <= static_friction * normal else kinetic_friction * normal
            impulse = impulse - tangential / slip_speed * slip
        b1.apply_impulse(-impulse, self.r1_vec)
        b2.apply_impulse(impulse, self.r2_vec)
