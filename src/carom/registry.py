"""The parts of carom by kind and name: its own parts, and parts of installed packages.

An installed package adds a part through an entry point, whose group is ``carom.`` and the kind:

    [project.entry-points."carom.forces"]
    harmonic-trap = "carom_example.trap:TRAP"

`carom.extend` has the classes and functions for such parts. A part is imported when it is used for the first time.
It is an error to use a name that two packages define, or that carom and a package define.
"""

from __future__ import annotations

import importlib
import importlib.util
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from functools import cache
from typing import Any, NamedTuple

from carom.errors import SceneError
from carom.held_signals import signals_held
from carom.scene.wording import suggestion, told_by

PREFIX = "carom."  # prefix of the groups of entry points
KINDS = {  # kind → its name in messages
    "forces": "force",
    "contact_laws": "contact law",
    "walls": "shape of a wall",
    "integrators": "integrator",
    "gravity_methods": "gravity method",
    "series": "recorded series",
    "placements": "placement of bodies",
    "data_formats": "data format",
    "export_formats": "export format",
    "engines": "engine",
    "engine_records": "engine that is recorded",
    "commands": "command",
}
HOUSE: Mapping[str, Mapping[str, str]] = {  # carom's own parts: kind → name → module:attribute
    "forces": {
        "gravity": "carom.physics.forces.gravity:make",
        "uniform-field": "carom.physics.forces.field:make",
        "drag": "carom.physics.forces.drag:make",
    },
    "gravity_methods": {
        "direct": "carom.physics.forces.gravity.direct:make",
        "tree": "carom.physics.forces.gravity.tree:make",
        "fast-multipole": "carom.physics.forces.gravity.fast_multipole.fast_multipole:make",
    },
    "integrators": {  # integrators that choose their own steps; other integrators are sequences of kicks and drifts
        "gauss-radau15": "carom.physics.integrators.gauss_radau.gauss_radau15:make",
        "wisdom-holman": "carom.physics.integrators.wisdom_holman.wisdom_holman:make",
    },
    "contact_laws": {
        "coulomb": "carom.scene.contact_laws:COULOMB",
        "rolling_resistance": "carom.laws.rolling_resistance:LAW",
        "viscoelastic": "carom.laws.viscoelastic:LAW",
        "power_law": "carom.laws.power_law:LAW",
        "restitution_table": "carom.laws.restitution_table:LAW",
        "walton": "carom.laws.walton:LAW",
    },
    "walls": {
        "cylinder": "carom.walls.cylinder:WALL",
        "sphere": "carom.walls.sphere:WALL",
        "cone": "carom.walls.frustum:WALL",
        "disc": "carom.walls.disc:WALL",
        "rectangle": "carom.walls.rectangle:WALL",
        "mesh": "carom.walls.mesh:WALL",
    },
    "placements": {  # arrangements of groups, and the shape of a region that has velocities of its own
        "random": "carom.physics.placement.random_placement:RANDOM",
        "compressed": "carom.physics.placement.growth:COMPRESSED",
        "cubic": "carom.physics.placement.lattice:LATTICE",
        "fcc": "carom.physics.placement.lattice:LATTICE",
        "hcp": "carom.physics.placement.lattice:LATTICE",
        "plummer": "carom.physics.placement.plummer:PLUMMER",
    },
    "data_formats": {
        "csv": "carom.scene.data.arrow_tables:CSV",
        "tsv": "carom.scene.data.arrow_tables:CSV",
        "txt": "carom.scene.data.arrow_tables:CSV",
        "dat": "carom.scene.data.arrow_tables:CSV",
        "ecsv": "carom.scene.data.arrow_tables:CSV",
        "dump": "carom.scene.data.particle_text:DUMP",
        "lammpstrj": "carom.scene.data.particle_text:DUMP",
        "liggghts": "carom.scene.data.particle_text:DUMP",
        "data": "carom.scene.data.mercury_table:DATA",
        "lmp": "carom.scene.data.particle_text:DATA",
        "xyz": "carom.scene.data.particle_text:XYZ",
        "extxyz": "carom.scene.data.particle_text:XYZ",
        "vtk": "carom.scene.data.vtk_tables:VTK",
        "vtp": "carom.scene.data.vtk_tables:VTP",
        "vtu": "carom.scene.data.vtk_tables:VTP",
        "gsd": "carom.scene.data.array_tables:GSD",
        "mpcorb": "carom.scene.data.orbit_tables:MPC",
        "horizons": "carom.scene.data.orbit_tables:HORIZONS",
        "parquet": "carom.scene.data.arrow_tables:PARQUET",
        "arrow": "carom.scene.data.arrow_tables:ARROW",
        "feather": "carom.scene.data.arrow_tables:ARROW",
        "npz": "carom.scene.data.array_tables:NPZ",
        "h5": "carom.scene.data.array_tables:HDF5",
        "h5md": "carom.scene.data.array_tables:HDF5",
        "hdf5": "carom.scene.data.array_tables:HDF5",
        "bin": "carom.scene.data.rebound_archive:REBOUND",
        "rebound": "carom.scene.data.rebound_archive:REBOUND",
    },
    "export_formats": {
        "parquet": "carom.recording.export.table_files:PARQUET",
        "csv": "carom.recording.export.table_files:CSV",
        "arrow": "carom.recording.export.table_files:ARROW",
        "npz": "carom.recording.export.npz:write_npz",
        "extxyz": "carom.recording.export.extended_xyz:write_extended_xyz",
        "vtk": "carom.recording.export.vtk:VTK",
    },
    "engines": {
        "rebound": "carom.engines.adapters.rebound:Rebound",
        "mujoco": "carom.engines.adapters.mujoco:MuJoCo",
        "box3d": "carom.engines.adapters.box3d:Box3D",
        "pybullet": "carom.engines.adapters.pybullet:PyBullet",
        "newton": "carom.engines.adapters.newton:Newton",
    },
    "engine_records": {  # functions of `carom.record`
        "rebound": "carom.engines.adapters.rebound:rebound",
        "mujoco": "carom.engines.adapters.mujoco:mujoco",
        "box3d": "carom.engines.adapters.box3d:box3d",
        "pybullet": "carom.engines.adapters.pybullet:pybullet",
        "newton": "carom.engines.adapters.newton:newton",
    },
    # optional parts of the physics, which packages cannot define; for parts of a step see `carom.plan.step_parts`
    "model": {
        "piston": "carom.physics.contact.piston_motion:PistonPlanes",
        "steady-steps": "carom.physics.contact.events.steady_steps:make",
    },
}

MADE_OF: Mapping[str, tuple[str, ...]] = {  # kind → the classes of its parts; parts of other kinds are functions
    "forces": ("carom.scene.installed_forces:BodyForce", "carom.scene.installed_forces:PairForce"),
    "contact_laws": ("carom.scene.contact_laws:ContactLaw",),
    "walls": ("carom.scene.wall_shapes:WallShape",),
    "integrators": ("carom.scene.integrators:Integrator",),
    "series": ("carom.recording.schema.series:Series",),
    "placements": ("carom.physics.placement.region:Arrangement",),
    "data_formats": ("carom.scene.data:DataFormat",),
}


class ExtensionError(SceneError):
    """A part that is not installed, cannot be imported, or is defined twice."""


class PartOrigin(NamedTuple):
    """The origin of a part."""

    target: str  # module:attribute
    package: str  # the distribution that defines the part; empty for carom's own parts
    version: str  # version of the distribution


def names(kind: str) -> tuple[str, ...]:
    """Return the names of all parts of a kind: carom's own parts first, then installed parts by name."""
    own = HOUSE.get(kind, {})
    return (*own, *(name for name in installed(kind) if name not in own))


def installed(kind: str) -> tuple[str, ...]:
    """Return the names of the parts of a kind in installed packages, in alphabetical order."""
    return tuple(sorted(_installed().get(kind, {})))


def origin(kind: str, name: str) -> PartOrigin | None:
    """Return the origin of a part of an installed package; None if no package defines it.

    Raises `ExtensionError` if two packages define the name, or if carom and a package define it.
    """
    origins = _installed().get(kind, {}).get(name, ())
    own = HOUSE.get(kind, {}).get(name)
    if origins and own:
        raise ExtensionError(
            f'the package {origins[0].package} defines a {KINDS[kind]} "{name}", which carom already has; '
            "rename it in the package, or uninstall the package"
        )
    if len(origins) > 1:
        both = " and ".join(each.package for each in origins)
        raise ExtensionError(f'the packages {both} both define a {KINDS[kind]} "{name}"; uninstall one of them')
    return origins[0] if origins else None


def source_of(kind: str, name: str) -> str:
    """Return the package and version of a part, for messages; "carom" for its own parts."""
    found = origin(kind, name)
    return f"{found.package} {found.version}" if found else "carom"


def load(kind: str, name: str) -> Any:
    """Return a part; raises `ExtensionError` if its name is unknown or defined twice, or it cannot be imported."""
    found = origin(kind, name)
    target = found.target if found else HOUSE.get(kind, {}).get(name)
    if target is None:
        known = names(kind)
        near = suggestion(name, known) if known else f"no installed package has a {KINDS[kind]} (in {sys.prefix})"
        raise ExtensionError(f'no {KINDS[kind]} "{name}"; {near}')
    if found is None:
        return imported(target)
    with refused_if_broken(kind, name):
        part = imported(target)
        _refuse_wrong(kind, part)
    return part


@contextmanager
def refused_if_broken(kind: str, name: str) -> Iterator[None]:
    """Raise `ExtensionError` for any exception from the code of a package, such as SystemExit or KeyboardInterrupt.

    Signals wait meanwhile, so an interrupt raised here does not come from the user.
    """
    with signals_held():
        try:
            yield
        except BaseException as error:
            reason = told_by(error)
            raise ExtensionError(
                f'the {KINDS[kind]} "{name}" of the package {source_of(kind, name)} cannot be loaded: '
                f"{type(error).__name__}{': ' if reason else ''}{reason}"
            ) from error


def _refuse_wrong(kind: str, part: Any) -> None:
    """Raise TypeError if an object is not a part of its kind."""
    known = tuple(imported(target) for target in MADE_OF.get(kind, ()))
    if known and not isinstance(part, known):
        wanted = " or ".join(each.__name__ for each in known)
        raise TypeError(f"it is an object of type {type(part).__name__} instead of {wanted}")
    if not known and not callable(part):
        raise TypeError(f"it is an object of type {type(part).__name__}, which cannot be called")


def imported(target: str) -> Any:
    """Return the attribute of a module, given as module:attribute."""
    module, _, attribute = target.partition(":")
    try:
        with signals_held():
            part: Any = importlib.import_module(module)
    except ModuleNotFoundError as error:
        if not (error.name or "").startswith(PREFIX):
            raise
        raise ExtensionError(
            f"{module} needs {error.name}, which was removed from this installation of carom"
        ) from error
    for name in filter(None, attribute.split(".")):
        part = getattr(part, name)
    return part


@cache
def _installed() -> Mapping[str, Mapping[str, tuple[PartOrigin, ...]]]:
    """Return the parts of installed packages by kind and name; a package that is found twice appears once."""
    from importlib.metadata import distributions  # noqa: PLC0415 - takes 20 ms, which `carom --version` need not wait for

    found: dict[str, dict[str, dict[str, PartOrigin]]] = {}
    for distribution in distributions():
        try:
            text = distribution.read_text("entry_points.txt") or ""
            if f"[{PREFIX}" not in text:
                continue
            about = dict(distribution.metadata.json)
            package, version = str(about.get("name", "?")), str(about.get("version", "?"))
            entries = [each for each in distribution.entry_points if each.group.startswith(PREFIX)]
        except Exception:  # metadata of a package are damaged, perhaps of a package that is not needed
            continue
        for entry in entries:
            if (kind := entry.group.removeprefix(PREFIX)) in KINDS:
                by_name = found.setdefault(kind, {}).setdefault(entry.name, {})
                by_name.setdefault(package, PartOrigin(entry.value, package, version))
    return {
        kind: {name: tuple(origins.values()) for name, origins in by_name.items()} for kind, by_name in found.items()
    }
