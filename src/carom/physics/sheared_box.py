"""A periodic box under uniform shear: the images along the gradient move (Lees & Edwards 1972).

With the shear rate γ, the flow along x and the gradient along y, the mean velocity is u = γ y x̂. In a box of size L,
image k along the gradient has at time t the position and the velocity

    x + k (L_y ŷ + s x̂),    v + k γ L_y x̂,    s = γ L_y t

where s is reduced modulo L_x. A body that leaves the box through a face along y enters through the other face as its
image: its position changes by ∓(L_y ŷ + s x̂), its velocity by ∓γ L_y x̂. The velocity of the body relative to the
flow, v - γ y x̂, does not change.

Within a step, the paths of bodies and of their images are straight lines, with different velocities. Times of impact
are found for each image that comes near (`time_of_impact.first_of_images`), and an impact uses the velocity relative to
the image. Bodies are wrapped at the end of the step.

Let w be the velocity of an image relative to its body, and J the impulse on it in an impact. The impact changes the
energy of both bodies by the dissipated energy, and by the work -J·w. This work plus the change of Σ ½ m v² by wrapping
is the work of the shear. The ledger books it as an entry, in which a loss is positive. The momentum that bodies gain by
wrapping is added to the expected momentum. In coordinates that the shear carries along,

    x' = x - (s/L_y) y

the images form a grid at rest, and bodies move only relative to the flow. The broad phase searches in these
coordinates, within distances multiplied by the largest stretch of x ↦ x' and of the flow within a step
(`ShearedBox.stretch`).

Lasting contacts are resolved at the end of a step, with the images where they are at that time. Records of contacts
then have a field for w, so that the solver finds impulses from velocities relative to the image. The work of these
impulses is booked like the work of an impact. A packing in the flow is never at rest: the relative velocity of two
neighbours, γ d for centres at a distance d, changes by its own magnitude within a time 1/γ. A contact is at rest if it
closes at most twice as fast as the acceleration γ² d could make it close in a step.

Numba compiles the functions below for each type of box (an array of sizes, or the record of a sheared box) and for each
type of contact (with or without w).
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, Protocol, cast

import numpy as np

from carom.arrays import FloatArray, RecordArray, dtype_of
from carom.physics.contact.records import ImageVelocity
from carom.physics.jit.decorators import chosen_by_type, inline, inner, kernel, with_field
from carom.physics.vector import Vector, minimum_image, nearest_image
from carom.scene.portable_math import ENDLESS

if TYPE_CHECKING:
    from carom.physics.bodies import Bodies
    from carom.scene.schema.shear import Shear

ENTRY = "shear"  # name of the ledger entry, which is -W because a loss is positive


class ShearedBoxRecord(Protocol):
    """A sheared box in a step."""

    flow: int  # axis of the mean velocity
    gradient: int  # axis along which the mean velocity changes
    rate: float  # 1/s, γ
    depth: float  # m, size of the box along the gradient
    speed: float  # m/s, velocity of the next image along the gradient
    shift: float  # m, displacement of the next image along the flow, as the step begins or when contacts are found
    period_x: float  # m, size of the box along x; this field and the next two are `ENDLESS` along the gradient
    period_y: float
    period_z: float
    work: float  # J, work of the shear in impacts since `ShearedBox.pop`


SHEARED_BOX = dtype_of(ShearedBoxRecord)


class ShearedBox:
    """The images of a sheared box, from step to step, given the size of the box, (3,) m."""

    def __init__(self, shear: Shear, size: FloatArray) -> None:
        self._shear, self._size, (self._flow, self._gradient) = shear, size, shear.axes
        self._depth, self.rate = float(size[self._gradient]), shear.rate
        periods = np.where(np.arange(3) == self._gradient, ENDLESS, size).tolist()
        speed = shear.rate * self._depth
        axes = self._flow, self._gradient
        # (1,), for kernels
        self.record = np.array([(*axes, shear.rate, self._depth, speed, 0.0, *periods, 0.0)], SHEARED_BOX)
        self._impulse = 0.0  # N s, momentum along the flow gained by wrapping bodies since the last `pop`
        self._work = 0.0  # J, work of the shear by wrapping

    def begin(self, time: float) -> None:
        """Place the images at a time (s), as a step begins or as its contacts are found."""
        self.record["shift"] = self._shear.shift(self._size, time)

    def at(self, time: float) -> FloatArray:
        """Return the record at a time (s), for kernels that accept any box."""
        self.begin(time)
        return self.at_present

    @property
    def at_present(self) -> FloatArray:
        """The record at the present time, for kernels that accept any box."""
        return cast(FloatArray, self.record)

    def relative(self, velocity: FloatArray, position: FloatArray) -> FloatArray:
        """Return velocities relative to the flow at ``position``, (n, 3) m/s."""
        relative = velocity.copy()
        relative[:, self._flow] -= self.rate * position[:, self._gradient]
        return relative

    def carried(self, position: FloatArray) -> FloatArray:
        """Return positions x', (n, 3) m, in coordinates that the shear carries along, as the step begins."""
        carried = position.copy()
        carried[:, self._flow] -= self._slope * position[:, self._gradient]
        return carried

    def acceleration(self, diameter: float) -> float:
        """Return the relative acceleration (m/s²) of two bodies in the flow, ``diameter`` (m) apart."""
        return self.rate * self.rate * diameter

    def add_work(self, contacts: RecordArray[Any], impulses: RecordArray[Any]) -> None:
        """Book the work of the shear by impulses of contacts; both arguments, (m,), may be the same records."""
        self._work += _work_of_contacts(contacts, impulses)

    def add_work_of_corrections(self, contacts: RecordArray[Any], impulses: RecordArray[Any]) -> None:
        """Book the work of the shear by the recorded corrections of overlaps."""
        self._work += _work_of_corrections(contacts, impulses)

    def stretch(self, dt: float) -> float:
        """Return the factor for search distances that covers the stretch by x ↦ x', and by the flow in dt s."""
        return _largest_stretch(self._slope) * _largest_stretch(self.rate * dt)

    @property
    def _slope(self) -> float:
        return float(self.record["shift"][0]) / self._depth

    def wrap(self, bodies: Bodies, time: float) -> None:
        """Wrap all centres into the box at a time (s), the end of a step, with their velocities; book the work."""
        state = bodies.position, bodies.velocity, bodies.mass
        work, impulse = _wrap(*state, self.record, self._shear.shift(self._size, time))
        self._work, self._impulse = self._work + work, self._impulse + impulse

    def pop(self) -> tuple[float, FloatArray]:
        """Return the work of the shear since the last call (J), and the momentum gained by wrapping (3,) N s."""
        work, impulse = self._work + float(self.record["work"][0]), np.zeros(3)
        impulse[self._flow] = self._impulse
        self._work = self._impulse = 0.0
        self.record["work"] = 0.0
        return work, impulse


def _largest_stretch(slope: float) -> float:
    """Return the largest singular value of x ↦ x + slope y."""
    half = 0.5 * abs(slope)
    return half + math.sqrt(1.0 + half * half)


@kernel
def _wrap(
    position: FloatArray, velocity: FloatArray, mass: FloatArray, box: RecordArray[ShearedBoxRecord], shift: float
) -> tuple[float, float]:
    """Wrap all centres; return the change of the kinetic energy (J), and of the momentum along the flow (N s)."""
    B, work, impulse = box[0], 0.0, 0.0
    f, g = B.flow, B.gradient
    for i in range(len(position)):
        k = _image(position[i, g], B.depth)
        if k != 0.0:
            position[i, g] -= k * B.depth
            position[i, f] -= k * shift
            change, v = -k * B.speed, velocity[i, f]
            velocity[i, f] = v + change
            work += mass[i] * change * (v + 0.5 * change)
            impulse += mass[i] * change
        position[i, 0] = minimum_image(position[i, 0], B.period_x)
        position[i, 1] = minimum_image(position[i, 1], B.period_y)
        position[i, 2] = minimum_image(position[i, 2], B.period_z)
    return work, impulse


@kernel
def _work_of_contacts(contacts: RecordArray[Any], impulses: RecordArray[Any]) -> float:
    """Return -Σ J·w in J."""
    work = 0.0
    for c in range(len(contacts)):
        contact, given = contacts[c], impulses[c]
        J = given.normal_impulse
        Jx, Jy, Jz = J * contact.nx, J * contact.ny, J * contact.nz
        work -= along_image(contact, Jx + given.friction_x, Jy + given.friction_y, Jz + given.friction_z)
    return work


@kernel
def _work_of_corrections(contacts: RecordArray[Any], impulses: RecordArray[Any]) -> float:
    work = 0.0
    for c in range(len(contacts)):
        given = impulses[c]
        work -= along_image(contacts[c], given.correction_x, given.correction_y, given.correction_z)
    return work


@inner
def _image(d: float, depth: float) -> float:
    """Return the number of the image in which a coordinate along the gradient lies."""
    return float(np.floor(d / depth + 0.5))


@inner
def along_gradient(x: float, y: float, z: float, axis: int) -> float:
    """Return the component of a vector along an axis."""
    return x if axis == 0 else (y if axis == 1 else z)


@inner
def in_axes(B: ShearedBoxRecord, flow: float, gradient: float) -> Vector:
    """Return a vector with two components, along the flow and the gradient."""
    f, g = B.flow, B.gradient
    x = flow if f == 0 else (gradient if g == 0 else 0.0)
    y = flow if f == 1 else (gradient if g == 1 else 0.0)
    z = flow if f == 2 else (gradient if g == 2 else 0.0)
    return x, y, z


@inline
def along_image(contact: ImageVelocity, Jx: float, Jy: float, Jz: float) -> float:
    """Return J·w in J."""
    return Jx * contact.image_x + Jy * contact.image_y + Jz * contact.image_z


# Forms for a sheared box or for a contact with w. The functions further below, which kernels call, are the other forms.


def _nearest(dx: float, dy: float, dz: float, box: Any, clock: float) -> Vector:
    B = box[0]
    k = _image(along_gradient(dx, dy, dz, B.gradient), B.depth)
    sx, sy, sz = in_axes(B, k * (B.shift + B.speed * clock), k * B.depth)
    return nearest_image(dx - sx, dy - sy, dz - sz, (B.period_x, B.period_y, B.period_z))


def _velocity(dx: float, dy: float, dz: float, box: Any) -> Vector:
    B = box[0]
    return in_axes(B, -_image(along_gradient(dx, dy, dz, B.gradient), B.depth) * B.speed, 0.0)


def _flow(box: Any, x: float, y: float, z: float, dt: float) -> Vector:
    B = box[0]
    return in_axes(B, B.rate * along_gradient(x, y, z, B.gradient) * dt, 0.0)


def _add_work(box: Any, work: float) -> None:
    box[0].work += work


def _slope_of_image(contact: Any, slope: float, Jx: float, Jy: float, Jz: float) -> float:
    return slope + along_image(contact, Jx, Jy, Jz)


def _set_image_velocity(contact: Any, dx: float, dy: float, dz: float, box: Any) -> None:
    contact.image_x, contact.image_y, contact.image_z = velocity_of_image(dx, dy, dz, box)


def _image_velocity(contact: Any, ux: float, uy: float, uz: float) -> Vector:
    return ux + contact.image_x, uy + contact.image_y, uz + contact.image_z


@with_field("shift", lambda box: True)
def is_sheared(box: Any) -> bool:
    """Return whether a box is sheared; a constant in compiled kernels."""
    return False


@with_field("shift", lambda box: (box[0].period_x, box[0].period_y, box[0].period_z))
def periods(box: Any) -> Vector:
    """Return the size (m) of a periodic box; `ENDLESS` along the gradient of a sheared box."""
    return box[0], box[1], box[2]


@with_field("shift", _nearest, place=3)
def nearest_in_drift(dx: float, dy: float, dz: float, box: Any, clock: float) -> Vector:
    """Return a separation (m) to the nearest image at a time (s) since the step began."""
    return nearest_image(dx, dy, dz, box)


@with_field("shift", _velocity, place=3)
def velocity_of_image(dx: float, dy: float, dz: float, box: Any) -> Vector:
    """Return the velocity (m/s) of a body's nearest image relative to the body, given the separation (m)."""
    return 0.0, 0.0, 0.0


@with_field("shift", _flow)
def flow_in_drift(box: Any, x: float, y: float, z: float, dt: float) -> Vector:
    """Return the displacement (m) that the flow at a place causes in a time (s)."""
    return 0.0, 0.0, 0.0


@with_field("shift", _add_work)
def add_work(box: Any, work: float) -> None:
    """Add work (J) of the shear."""


@with_field("image_x", _slope_of_image)
def slope_of_image(contact: object, slope: float, Jx: float, Jy: float, Jz: float) -> float:
    """Add J·w to a sum of impulses times velocities (J), since the velocities of bodies do not contain w."""
    return slope


@with_field("image_x", _set_image_velocity)
def set_image_velocity(contact: object, dx: float, dy: float, dz: float, box: Any) -> None:
    """Set w of a contact, if it has this field, given the separation (m) of its bodies in the box."""


def relative_to_image(contact: Any, ux: float, uy: float, uz: float) -> Vector:
    """Return the velocity (m/s) of the image of j relative to i, given that of body j; for numbers and lanes."""
    return _image_velocity(contact, ux, uy, uz) if hasattr(contact, "image_x") else (ux, uy, uz)


@chosen_by_type(relative_to_image)
def _relative_to_image(contact: Any, ux: Any, uy: Any, uz: Any) -> Any:
    return _image_velocity if "image_x" in contact.fields else lambda contact, ux, uy, uz: (ux, uy, uz)
