"""Planes and walls that change their place: at constant velocities, or oscillating.

At the time t, such a wall is displaced from its place in the scene by

    D(t) = D_k + V_k (t - t_k) + A sin θ,    θ = 2π f t + φ

so its place follows from the time alone, and checkpoints do not store it. The velocity V_k lasts from t_k to t_{k+1},
where a step ends (`next_change`), so V is constant within each step. Kernels evaluate the shape at x - D. Within a
drift that begins at t₀, the wall is displaced further by r(τ) = D(t₀ + τ) - D(t₀), and the path of a body relative to
it has a second derivative of at most |g| + |A| (2π f)². Times of impact follow from r and this bound, as for a wall at
rest.

A contact at rest is held as if kicks moved a wall of infinite mass. In a drift of dt, the wall has its mean velocity
v̄ = r(dt)/dt, so a held body stays on the wall. The first kick changes the wall's velocity by v̄ - Ḋ(t₀), and the
velocity after the last kick is Ḋ(t₀ + dt).

All relative velocities contain the velocity of the wall. The ledger books the energy that contacts dissipate, and the
work that the wall does on the bodies. With the impulses λ_n n + λ_t on the wall, this work is

    W = -(λ_n n + λ_t)·Ḋ

where Ḋ is evaluated at t₀ for impulses of the first kick, at the time of an impact for its impulse, and at t₀ + dt for
impulses of the last kick. Records of solids have these fields only in scenes with such walls; see `moving_walls`.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from carom.arrays import FloatArray, IntArray, RecordArray, Records
from carom.physics.contact.guided_walls import GUIDE, guided_displacement
from carom.physics.contact.records import ContactRecord, ImpactRecord, ImpulseRecord
from carom.physics.jit.decorators import inline, kernel, with_field
from carom.physics.rotation import TWO_PI, sine_cosine
from carom.physics.vector import Vector, vector
from carom.scene.schema.motion import WallMotion

if TYPE_CHECKING:
    from carom.physics.bodies import Ends

_SHIFT = ("motion_shift_x", "motion_shift_y", "motion_shift_z")  # m, components of D at the present phase of the step
TRANSLATION = (
    *_SHIFT,
    *("motion_velocity_x", "motion_velocity_y", "motion_velocity_z"),  # m/s, V_k
    *("motion_origin_x", "motion_origin_y", "motion_origin_z"),  # m, D_k
    "motion_since",  # s, t_k
    *("motion_amplitude_x", "motion_amplitude_y", "motion_amplitude_z"),  # m, A
    *("motion_frequency", "motion_phase"),  # 1/s, f; φ/2π
    "motion_angle",  # rad, θ at the beginning of the step, without whole turns
    "motion_fastest",  # m/s², |A| (2π f)²
    *GUIDE,
)
_PIECE = TRANSLATION[3:10]  # V_k, D_k, t_k


def translation_of(motion: WallMotion | None) -> FloatArray:
    """Return the fields `TRANSLATION` of a wall at the time 0, without the shift."""
    if motion is None or not motion.translates:
        return np.zeros(len(TRANSLATION))
    amplitude, frequency = np.array(motion.amplitude), motion.frequency or 0.0
    omega = TWO_PI * frequency
    fastest = omega * omega * np.sqrt((amplitude * amplitude).sum())
    oscillation = [*amplitude, frequency, motion.phase / TWO_PI, 0.0, fastest]
    return np.array([0.0] * 3 + [*motion.velocity] + [0.0] * 4 + oscillation + [0.0] * len(GUIDE))


def _pieces_of(motion: WallMotion) -> FloatArray:
    """Return the fields `_PIECE` of a wall whose motion has `times`, (k, 7); the wall is at rest before `times[0]`."""
    times, velocities = np.array([0.0, *motion.times]), np.array([(0.0, 0.0, 0.0), *motion.velocities])
    steps = velocities[:-1] * np.diff(times)[:, None]
    displacements = np.concatenate((np.zeros((1, 3)), np.cumsum(steps, axis=0)))
    return np.concatenate((velocities, displacements, times[:, None]), axis=1)


def in_frame_of_wall(nearest: Callable[..., Any]) -> Callable[..., Any]:
    """Return the function `WallShape.nearest` of a wall that is displaced by D."""

    def displaced(p: Any, x: float, y: float, z: float) -> Any:
        return nearest(p, x - p.motion_shift_x, y - p.motion_shift_y, z - p.motion_shift_z)

    return inline(displaced)


class WallTranslation:
    """Moves the walls of a scene through the phases of a step.

    The places of these walls follow from the time. A subclass for walls that contacts move (`guided_walls`) also
    replaces `forget`, `memory`, `recall`, `longest_step`, `push` and `settle`.

    Parameters
    ----------
    records, before
        Records of all solids, (p,), with the fields `TRANSLATION`. Both are written, ``before`` when a step begins.
    ends
        The velocities and accelerations of the solids, which are written.
    motions
        The motion of each solid; None if it has none.
    """

    def __init__(self, records: Records, before: Records, ends: Ends, motions: Sequence[WallMotion | None]) -> None:
        self._records: Any = records
        self._before = before
        bodies = len(ends.velocity) - len(records)
        changing = {id(motion): motion for motion in motions if motion and motion.times}
        self._pieces = [  # solids and pieces of each motion
            (np.flatnonzero([other is motion for other in motions]), _pieces_of(motion)) for motion in changing.values()
        ]
        self._changes = sorted({float(time) for _, pieces in self._pieces for time in pieces[1:, -1]})  # s
        self._velocity, self._acceleration = ends.velocity[bodies:], ends.acceleration[bodies:]
        self._begun = np.zeros_like(self._velocity)  # m/s, Ḋ at the beginning of the step
        self._mean = np.zeros_like(self._velocity)  # m/s, v̄
        self._after = 0.0  # s, time from the middle of the step to its end
        self.place(0.0)
        mean_velocities(self._records, 0.0, 1.0, self._mean)  # loads the kernel

    def place(self, time: float) -> None:
        """Move the walls to their places at a time (s), between two steps."""
        self._set_velocities(time)
        place(self._records, time, self._velocity)
        self.rest()

    def begin(self, before: float, time: float, dt: float, booked: float) -> FloatArray:
        """Begin a step between two times with a drift of ``dt``; return Ḋ as it begins, (p, 3) m/s.

        ``booked`` is the length of the first kick. All times are in s.
        """
        self._set_velocities(0.5 * (before + time))
        place(self._records, before, self._begun)
        self._before[:] = self._records
        mean_velocities(self._records, time, dt, self._mean)
        self._after = dt - booked
        self._velocity[:] = self._mean
        self._acceleration[:] = (self._mean - self._begun) / booked if booked > 0.0 else 0.0
        return self._begun

    def begin_drift(self) -> None:
        """Set the velocities of walls to 0: in a drift, `velocity_in_drift` adds them."""
        self._velocity[:] = self._acceleration[:] = 0.0

    def arrive(self, time: float) -> None:
        """Move the walls to the end of the step; bodies still have the velocities of the drift."""
        place(self._records, time, self._velocity)
        self._velocity[:] = self._mean

    def finish(self, time: float) -> None:
        """Give the walls their velocities after the last kick."""
        place(self._records, time, self._velocity)

    def accelerate(self) -> FloatArray:
        """Give the walls the accelerations of the last kick; return their velocities, (p, 3) m/s."""
        self._acceleration[:] = (self._velocity - self._mean) / self._after if self._after > 0.0 else 0.0
        return self._velocity

    def next_change(self, time: float) -> float:
        """Return the next time (s) after ``time`` (s) at which a wall's velocity changes; infinite if it never does."""
        following = bisect_right(self._changes, time)
        return self._changes[following] if following < len(self._changes) else np.inf

    def forget(self) -> None:
        """Return to the start of the run."""

    @property
    def memory(self) -> FloatArray | None:
        """A copy of the state of walls that contacts move; None if there are no such walls."""
        return None

    def recall(self, state: FloatArray) -> None:
        """Restore an earlier `memory`."""

    @property
    def longest_step(self) -> float:
        """The longest step (s) that walls moved by contacts allow; infinite without such walls."""
        return np.inf

    def push(self, distances: FloatArray) -> None:
        """Displace guided walls along their normals by ``distances``, (k,) m, to correct overlaps."""

    def settle(self) -> float:
        """Note the velocities that contacts gave walls in the step; return the walls' work on the bodies in J."""
        return 0.0

    def _set_velocities(self, time: float) -> None:
        """Write the velocities V_k at a time (s), with D_k and t_k."""
        for solids, pieces in self._pieces:
            k = bisect_right(pieces[:, -1], time) - 1
            for name, value in zip(_PIECE, pieces[k], strict=True):
                self._records[name][solids] = value

    def rest(self) -> None:
        """Give the walls no acceleration, so that position corrections book only the work of the bodies' forces."""
        self._acceleration[:] = 0.0


@kernel
def place(surface: Any, time: float, velocity: FloatArray) -> None:
    """Write the shift and the angle of each wall at a time (s), and its velocity (m/s)."""
    for k in range(len(surface)):
        wall = surface[k]
        cycles = wall.motion_frequency * time + wall.motion_phase
        wall.motion_angle = TWO_PI * (cycles - np.floor(cycles))
        sine, cosine = sine_cosine(wall.motion_angle)
        speed, since = TWO_PI * wall.motion_frequency * cosine, time - wall.motion_since
        wall.motion_shift_x = wall.motion_origin_x + wall.motion_velocity_x * since + wall.motion_amplitude_x * sine
        wall.motion_shift_y = wall.motion_origin_y + wall.motion_velocity_y * since + wall.motion_amplitude_y * sine
        wall.motion_shift_z = wall.motion_origin_z + wall.motion_velocity_z * since + wall.motion_amplitude_z * sine
        velocity[k, 0] = wall.motion_velocity_x + wall.motion_amplitude_x * speed
        velocity[k, 1] = wall.motion_velocity_y + wall.motion_amplitude_y * speed
        velocity[k, 2] = wall.motion_velocity_z + wall.motion_amplitude_z * speed


@kernel
def mean_velocities(surface: Any, time: float, dt: float, velocity: FloatArray) -> None:
    """Write the mean velocity (m/s) of each wall from its present place to its place at a time (s), over dt (s)."""
    for k in range(len(surface)):
        wall = surface[k]
        cycles = wall.motion_frequency * time + wall.motion_phase
        later, _ = sine_cosine(TWO_PI * (cycles - np.floor(cycles)))
        sine, _ = sine_cosine(wall.motion_angle)
        rate = (later - sine) / dt
        velocity[k, 0] = wall.motion_velocity_x + wall.motion_amplitude_x * rate
        velocity[k, 1] = wall.motion_velocity_y + wall.motion_amplitude_y * rate
        velocity[k, 2] = wall.motion_velocity_z + wall.motion_amplitude_z * rate


@kernel
def work_at_velocities(
    pairs: IntArray,
    contacts: RecordArray[ContactRecord],
    impulses: RecordArray[ImpulseRecord],
    velocity: FloatArray,
    bodies: int,
) -> float:
    """Return the work (J) that walls do on the first ``bodies`` ends by the impulses of contacts.

    ``impulses``, (m,), may be the records of the contacts; ``velocity`` is the velocity of the solids, (p, 3) m/s.
    """
    work = 0.0
    for c in range(len(pairs)):
        j = pairs[c, 1]
        if j >= bodies:
            work = _with_work_at(vector(velocity, j - bodies), contacts[c], impulses[c], work)
    return work


@kernel
def work_in_drift(log: RecordArray[ImpactRecord], surface: Any, bodies: int) -> float:
    """Return the work in J that walls with a prescribed motion do on bodies in impacts during a drift.

    See `work_at_velocities`. For a wall that contacts move, `WallTranslation.settle` books the work.
    """
    work = 0.0
    for k in range(len(log)):
        entry = log[k]
        if entry.j >= bodies:
            velocity = _prescribed_velocity(surface[entry.j - bodies], entry.time)
            work = _with_work_at(velocity, entry, entry, work)
    return work


@inline
def _with_work_at(velocity: Vector, contact: Any, given: Any, work: float) -> float:
    """Add the work W by the impulses ``given`` at a contact to ``work`` (J); the wall's velocity is in m/s."""
    vx, vy, vz = velocity
    work -= given.normal_impulse * (contact.nx * vx + contact.ny * vy + contact.nz * vz)
    work -= given.friction_x * vx + given.friction_y * vy + given.friction_z * vz
    return work


@with_field(TRANSLATION[0], lambda surface: True)
def walls_translate(surface: FloatArray) -> bool:
    """Return whether solids have the fields `TRANSLATION`; a constant in compiled kernels."""
    return False


def _shift(surface: Any, solid: int) -> Vector:
    wall = surface[solid]
    return wall.motion_shift_x, wall.motion_shift_y, wall.motion_shift_z


@with_field(TRANSLATION[0], _shift)
def shift_of(surface: FloatArray, solid: int) -> Vector:
    """Return D in m at the present phase of the step."""
    return 0.0, 0.0, 0.0


@with_field(TRANSLATION[0], lambda surface, solid: surface[solid].motion_fastest + abs(surface[solid].guide_bend))
def largest_acceleration(surface: FloatArray, solid: int) -> float:
    """Return the largest acceleration of a wall at any time, in m/s²."""
    return 0.0


def _displacement(surface: Any, solid: int, time: float) -> Vector:
    wall = surface[solid]
    rise = 0.0
    if wall.motion_frequency > 0.0:
        rise = sine_cosine(wall.motion_angle + TWO_PI * wall.motion_frequency * time)[0]
        rise -= sine_cosine(wall.motion_angle)[0]
    guided = guided_displacement(wall, time)
    return (
        wall.motion_velocity_x * time + wall.motion_amplitude_x * rise + guided * wall.plane_x,
        wall.motion_velocity_y * time + wall.motion_amplitude_y * rise + guided * wall.plane_y,
        wall.motion_velocity_z * time + wall.motion_amplitude_z * rise + guided * wall.plane_z,
    )


@with_field(TRANSLATION[0], _displacement)
def displacement_in_drift(surface: FloatArray, solid: int, time: float) -> Vector:
    """Return the displacement r (m) of a wall at a time (s) since the drift began."""
    return 0.0, 0.0, 0.0


@inline
def _prescribed_velocity(wall: Any, time: float) -> Vector:
    speed = 0.0
    if wall.motion_frequency > 0.0:
        omega = TWO_PI * wall.motion_frequency
        speed = omega * sine_cosine(wall.motion_angle + omega * time)[1]
    return (
        wall.motion_velocity_x + wall.motion_amplitude_x * speed,
        wall.motion_velocity_y + wall.motion_amplitude_y * speed,
        wall.motion_velocity_z + wall.motion_amplitude_z * speed,
    )


def _velocity(surface: Any, solid: int, time: float) -> Vector:
    wall = surface[solid]
    (vx, vy, vz), u = _prescribed_velocity(wall, time), wall.guide_speed
    return vx + u * wall.plane_x, vy + u * wall.plane_y, vz + u * wall.plane_z


@with_field(TRANSLATION[0], _velocity)
def velocity_in_drift(surface: FloatArray, solid: int, time: float) -> Vector:
    """Return the velocity of a wall in m/s at a time (s) since the drift began.

    If contacts move the wall, this is the velocity of its straight path, as for bodies; `Ends` has the acceleration.
    """
    return 0.0, 0.0, 0.0


def _rate(surface: Any, solid: int, time: float) -> Vector:
    (vx, vy, vz), wall = velocity_in_drift(surface, solid, time), surface[solid]
    u = wall.guide_bend * (time - wall.guide_half)
    return vx + u * wall.plane_x, vy + u * wall.plane_y, vz + u * wall.plane_z


@with_field(TRANSLATION[0], _rate)
def rate_in_drift(surface: FloatArray, solid: int, time: float) -> Vector:
    """Return the rate of change of `displacement_in_drift`, in m/s."""
    return 0.0, 0.0, 0.0
