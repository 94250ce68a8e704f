"""Simulationarchives of REBOUND, read by its package; an archive also has the law of motion of its particles."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import numpy as np

from carom.arrays import FloatArray
from carom.errors import SceneError, install_extra
from carom.scene.data import Arrays, DataFormat, DataTable, MotionLaw, Raw, refuse_many_rows
from carom.scene.data.facts import Facts, FileBox, printable
from carom.scene.units.system import SI, UnitSystem, units_of_rebound
from carom.scene.wording import counted

_GRAVITY = ("basic", "compensated", "tree", "jacobi", "mercurius", "trace")  # methods that sum the same forces
_INTEGRATORS = {  # REBOUND's name → the same method in carom
    "ias15": "gauss-radau15",
    "leapfrog": "leapfrog-dkd",
    "whfast": "wisdom-holman",
}
_CHOOSING = ("ias15", "bs", "none")  # integrators without a fixed step
_FUNCTIONS = "function pointers"  # words in the warning about a simulation with function pointers
_DAMAGED = "corrupted"  # words in the warning about a truncated archive
_KNOWN = (
    "test particle (type 0) has finite mass",
    "might not be synchronized",
)  # warnings about cases that are handled here


def open_rebound(path: Path, called: str, snapshot: int) -> DataTable:
    """Open a Simulationarchive at one of its snapshots."""
    rebound = _package(called)
    with warnings.catch_warnings(record=True) as given:
        warnings.simplefilter("always")
        archive = rebound.Simulationarchive(str(path))
        count = len(archive)
        if not -count <= snapshot < count:
            span = f"from t = {archive.tmin:g} to {archive.tmax:g}" if count > 1 else f"of t = {archive.tmin:g}"
            raise SceneError(f"{called}: there is no snapshot {snapshot}; the file has {count}, {span}")
        simulation = archive[snapshot % count]
        simulation.synchronize()  # between outputs, symplectic maps hold positions and velocities at different times
    texts = list(dict.fromkeys(str(warning.message) for warning in given))
    notes = [
        f"REBOUND warns: {text.splitlines()[0]}"
        for text in texts
        if not any(known in text for known in (_DAMAGED, _FUNCTIONS, *_KNOWN))
    ]
    if count > 1:
        notes.append(f"snapshot {snapshot % count} of {count} (from 0), t = {simulation.t:g}, is read")
    if any(_FUNCTIONS in text for text in texts):
        notes.append(
            "functions of its program (additional_forces, collision_resolve, REBOUNDx …) are not in an archive: what "
            "they do is missing here"
        )
    if any(_DAMAGED in text for text in texts):
        which = f"of {counted(count, 'intact snapshot')} number {snapshot % count}, t = {simulation.t:g}, is read"
        notes.insert(0, f"the file is damaged or ends early; {which}")
    if simulation.gravity not in (*_GRAVITY, "none"):
        raise SceneError(f'{called}: its gravity is "{printable(str(simulation.gravity))}", which carom lacks')
    if simulation.boundary not in ("none", "open", "periodic"):
        raise SceneError(f'{called}: its boundary is "{printable(str(simulation.boundary))}", which carom lacks')
    if simulation.boundary == "open":
        notes.append('boundary = "open": REBOUND removes bodies that leave its box, but carom keeps them')
    refuse_many_rows(called, simulation.N, path.stat().st_size)
    if simulation.N_var:
        notes.append(f"{counted(simulation.N_var, 'variational particle')} not used")
    particles = len(simulation.particles)  # excludes variational particles, which N includes before version 5
    # radii and masses are left out if all of them are 0
    everything = simulation.N
    position, velocity = np.zeros((everything, 3)), np.zeros((everything, 3))
    mass, radius = np.zeros(everything), np.zeros(everything)
    simulation.serialize_particle_data(xyz=position, vxvyvz=velocity, m=mass, r=radius)
    unnamed = getattr(simulation, "_N_name_list", 1) == 0  # REBOUND has names from version 5 on
    names = [] if unnamed else [getattr(simulation.particles[k], "name", None) or "" for k in range(particles)]
    arrays: dict[str, Raw] = {"position": position[:particles], "velocity": velocity[:particles]}
    arrays |= {"mass": _attracting(simulation, mass[:particles], called, notes), "radius": radius[:particles]}
    there = {name: array for name, array in arrays.items() if array.any() or name == "position"}
    table = Arrays(there | ({"name": np.array(names, dtype=object)} if any(names) else {}), called)
    units, box = units_of_rebound(simulation.units), None
    if simulation.boundary == "periodic":
        x, y, z = (float(simulation.root_size) * getattr(simulation, f"N_root_{axis}") for axis in "xyz")
        box = FileBox((-0.5 * x, -0.5 * y, -0.5 * z), (x, y, z), "xyz")
    name = printable(str(simulation.integrator))
    step = "" if name in _CHOOSING else f" with dt = {simulation.dt:g}"
    table.law = MotionLaw(
        constant=0.0 if simulation.gravity == "none" else float(simulation.G),
        softening=float(simulation.softening),
        collides=simulation.collision != "none",
        integrated=f'integrator = "{name}"{step}',
        integrator=_INTEGRATORS.get(str(simulation.integrator), ""),
        ghosts=(int(simulation.N_ghost_x), int(simulation.N_ghost_y), int(simulation.N_ghost_z)),
    )
    table.facts = Facts(units=UnitSystem.of_text(units) if units else SI, time=float(simulation.t), box=box)
    table.notes = tuple(f"{called}: {note}" for note in notes)
    return table


def times_of(path: Path, called: str) -> list[float]:
    """Return the times of the snapshots, in the units of the simulation."""
    rebound = _package(called)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        archive = rebound.Simulationarchive(str(path))
        return [float(archive.t[k]) for k in range(len(archive))]


def _package(called: str) -> Any:
    try:
        import rebound  # noqa: PLC0415 - an extra
    except ModuleNotFoundError:
        raise SceneError(f"{called}: a Simulationarchive needs rebound: {install_extra('rebound')}") from None
    return rebound


def _attracting(simulation: Any, mass: FloatArray, called: str, notes: list[str]) -> FloatArray:
    """Return the attracting masses: 0 for REBOUND's test particles, which attract nothing even if they have a mass."""
    n, active = len(mass), int(simulation.N_active)
    # an N_active of -1, or of the largest integer, which is the default, means that all particles are active
    light = mass[active:] if 0 <= active < n else mass[n:]
    if not light.any():
        return mass
    if simulation.testparticle_type == 0:
        few = counted(len(light), "test particle")
        notes.append(f"N_active = {active}: {few}, whose masses do not attract, have mass 0 here")
        return np.concatenate((mass[:active], np.zeros_like(light)))
    if len(light) > 1:
        raise SceneError(
            f"{called}: testparticle_type = 1 with N_active = {active}: {len(light)} bodies attract the others but "
            "not each other, which carom does not support; set N_active = -1 or testparticle_type = 0 in REBOUND"
        )
    return mass


REBOUND = DataFormat("a Simulationarchive of REBOUND", open_rebound, times_of)
