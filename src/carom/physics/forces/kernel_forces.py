"""Forces of installed packages: `BodyForce` and `PairForce` of `carom.scene.installed_forces`, in kernels.

Every kernel that sums accelerations calls `add_forces` with a tuple of records that hold the parameters, one for each
force. The type of a record names the force and a hash of its sources. For each tuple of types, Numba compiles a kernel
that contains the functions of the forces. The kernel is stored on disk under these types. Without such forces, the
tuple is empty, and the call compiles to nothing.

A body's terms are added in the order of their sources, whichever thread computes them, so all integrators and any
number of threads give the same bits. A pair is computed twice, once for each body.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from carom.arrays import FloatArray, Records
from carom.physics.bodies import Bodies
from carom.physics.jit.decorators import chosen_by_type, identity_of, inline, kernel, long_kernel
from carom.physics.jit.team import SOLO, Team
from carom.physics.vector import nearest_image
from carom.scene.forces import ForceKind, kind_called
from carom.scene.installed_forces import PairForce, force_called
from carom.scene.load import Scene

Parameters = tuple[Records, ...]  # (1,) records, one for each force

BODIES_PER_TASK = 2000  # bodies, about 10 µs of work
PAIRS_PER_TASK = 4000

_BODY, _PAIR = "body_force_", "pair_force_"  # prefixes of the first field of a record, which names the force


class _Compiled(NamedTuple):
    """The functions of a force, which kernels inline."""

    acceleration: Any  # acceleration function, or attraction of a pair
    potential: Any  # potential function; None for a force without a potential


_compiled: dict[str, _Compiled] = {}  # compiled functions by the first field of their records


class KernelForce:
    """A force of an installed package; see `Force`. `parameters` is the force's record, (1,), for `add_forces`."""

    def __init__(self, kind: ForceKind, parameters: Records, bodies: Bodies, box: FloatArray, team: Team) -> None:
        self.kind = kind
        self.uniform = np.zeros(3)
        self.parameters = parameters
        self._mass = bodies.mass
        self._box = box
        self._team = team
        names = parameters.dtype.names or ("",)
        pairs = len(bodies) if names[0].startswith(_PAIR) else 1
        self._bodies_per_task = max(1, PAIRS_PER_TASK // pairs) if pairs > 1 else BODIES_PER_TASK

    def accelerate(self, position: FloatArray, acceleration: FloatArray, *, first: bool, potential: bool) -> float:
        """Add the acceleration; see `Force`."""
        if first:
            acceleration[:] = 0.0
        state = (self.parameters,), position, self._mass, self._box
        self._team.divide(len(position), self._bodies_per_task, _add, *state, acceleration)
        return _energy(*state) if potential and self.kind.potential else 0.0

    def write(self, position: FloatArray, acceleration: FloatArray) -> None:
        """Write the acceleration by this force alone; for the arguments see `accelerate`."""
        self.accelerate(position, acceleration, first=True, potential=False)


def make(name: str, scene: Scene, bodies: Bodies, team: Team) -> KernelForce:
    """Return a force that has a section in a scene."""
    box = np.array(scene.domain.period or (0.0, 0.0, 0.0))
    return KernelForce(kind_called(name), parameters_of(name, scene), bodies, box, team)


def forces_of_packages(scene: Scene, bodies: Bodies) -> list[KernelForce]:
    """Return all forces of installed packages in a scene, for few bodies."""
    return [make(name, scene, bodies, SOLO) for name in scene.forces.given]


def parameters_of(name: str, scene: Scene) -> Records:
    """Return the record of a force with its parameters in a scene, (1,)."""
    force = force_called(name)
    is_pair = isinstance(force, PairForce)
    first = force.attraction if isinstance(force, PairForce) else force.acceleration
    functions = [first, force.potential] if force.potential else [first]
    marker = f"{_PAIR if is_pair else _BODY}{name}_{identity_of(*functions)}"
    if marker not in _compiled:
        _compiled[marker] = _Compiled(inline(first), inline(force.potential) if force.potential else None)
    values = force.parameters(scene.forces.given[name])
    record = np.zeros(1, np.dtype([(marker, np.float64), *((key, np.float64) for key in values)], align=True))
    for key, value in values.items():
        record[key] = value
    return record


def parameters_of_all(scene: Scene) -> Parameters:
    """Return the records of all forces of installed packages in a scene."""
    return tuple(parameters_of(name, scene) for name in scene.forces.given)


def add_forces(
    forces: Parameters, lo: int, hi: int, x: FloatArray, m: FloatArray, box: FloatArray, a: FloatArray
) -> None:
    """Add accelerations, (n, 3) m/s², of the bodies in [lo, hi), given records by `parameters_of`; for kernels.

    ``box``, (3,) m, is the size of a periodic box, or zeros.
    """
    raise NotImplementedError("only kernels call it")


def energy_of(forces: Parameters, x: FloatArray, m: FloatArray, box: FloatArray) -> float:
    """Return the potential energy in joules; for kernels, like `add_forces`."""
    raise NotImplementedError("only kernels call it")


def _functions(record: Any) -> tuple[bool, _Compiled]:
    """Return whether a force acts between bodies, and its functions, given the type of its record."""
    marker = next(iter(record.dtype.fields))
    return marker.startswith(_PAIR), _compiled[marker]


@chosen_by_type(add_forces)
def _adding(forces: Any, lo: Any, hi: Any, x: Any, m: Any, box: Any, a: Any) -> Any:
    """Return code that adds the first force, and calls `add_forces` for the others."""
    if len(forces) == 0:
        return lambda forces, lo, hi, x, m, box, a: None
    is_pair, functions = _functions(forces[0])
    function = functions.acceleration

    def of_bodies(forces: Any, lo: int, hi: int, x: FloatArray, m: FloatArray, box: FloatArray, a: FloatArray) -> None:
        p = forces[0][0]
        for i in range(lo, hi):
            ax, ay, az = function(x[i, 0], x[i, 1], x[i, 2], p)
            a[i, 0] += ax
            a[i, 1] += ay
            a[i, 2] += az
        add_forces(forces[1:], lo, hi, x, m, box, a)

    def of_pairs(forces: Any, lo: int, hi: int, x: FloatArray, m: FloatArray, box: FloatArray, a: FloatArray) -> None:
        p = forces[0][0]
        for i in range(lo, hi):
            fx, fy, fz = 0.0, 0.0, 0.0
            for j in range(len(x)):
                if j == i:
                    continue
                dx, dy, dz = x[j, 0] - x[i, 0], x[j, 1] - x[i, 1], x[j, 2] - x[i, 2]
                dx, dy, dz = nearest_image(dx, dy, dz, box)
                f = function(dx * dx + dy * dy + dz * dz, m[i], m[j], p)
                fx += f * dx
                fy += f * dy
                fz += f * dz
            a[i, 0] += fx / m[i]
            a[i, 1] += fy / m[i]
            a[i, 2] += fz / m[i]
        add_forces(forces[1:], lo, hi, x, m, box, a)

    return of_pairs if is_pair else of_bodies


@chosen_by_type(energy_of)
def _summing(forces: Any, x: Any, m: Any, box: Any) -> Any:
    if len(forces) == 0:
        return lambda forces, x, m, box: 0.0
    is_pair, functions = _functions(forces[0])
    function = functions.potential

    def of_bodies(forces: Any, x: FloatArray, m: FloatArray, box: FloatArray) -> float:
        p, energy = forces[0][0], 0.0
        for i in range(len(x)):
            energy += m[i] * function(x[i, 0], x[i, 1], x[i, 2], p)
        return energy + energy_of(forces[1:], x, m, box)

    def of_pairs(forces: Any, x: FloatArray, m: FloatArray, box: FloatArray) -> float:
        p, energy = forces[0][0], 0.0
        for i in range(len(x)):
            for j in range(i + 1, len(x)):
                dx, dy, dz = x[j, 0] - x[i, 0], x[j, 1] - x[i, 1], x[j, 2] - x[i, 2]
                dx, dy, dz = nearest_image(dx, dy, dz, box)
                energy += function(dx * dx + dy * dy + dz * dz, m[i], m[j], p)
        return energy + energy_of(forces[1:], x, m, box)

    return of_pairs if is_pair else of_bodies


@long_kernel
def _add(lo: int, hi: int, forces: Parameters, x: FloatArray, m: FloatArray, box: FloatArray, a: FloatArray) -> None:
    add_forces(forces, lo, hi, x, m, box, a)


@kernel
def _energy(forces: Parameters, x: FloatArray, m: FloatArray, box: FloatArray) -> float:
    return energy_of(forces, x, m, box)
