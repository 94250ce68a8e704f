"""The interface for packages that extend carom, in addition to the names of `carom`.

An extension is a package that names its parts in its ``pyproject.toml``, as `carom.registry` describes;
``examples/extension`` has parts of most kinds. docs/extending.md explains each name. Names are imported at their
first use, so that a command of a package starts as fast as a command of carom. carom itself imports each name from the
module that defines it, except in `laws` and `walls`, which are built like extensions.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from carom.engines.engine import Engine as Engine
    from carom.engines.engine import EngineSimulation as EngineSimulation
    from carom.engines.engine import Problem as Problem
    from carom.engines.engine import SteppedEngine as SteppedEngine
    from carom.engines.engine import dt_of as dt_of
    from carom.engines.engine import problem_of as problem_of
    from carom.engines.engine import refuse as refuse
    from carom.engines.source import engine_package as engine_package
    from carom.engines.source import named_version as named_version
    from carom.errors import needing as needing
    from carom.lab.compared_run import Setting as Setting
    from carom.lab.compared_run import Trajectory as Trajectory
    from carom.physics.exponential import exponential as exponential
    from carom.physics.exponential import logarithm as logarithm
    from carom.physics.exponential import power as power
    from carom.physics.jit.decorators import kernel as kernel
    from carom.recording.edit.bundle import opened as opened
    from carom.recording.export import Snapshot as Snapshot
    from carom.recording.export import StepFiles as StepFiles
    from carom.recording.export import TableFiles as TableFiles
    from carom.recording.read.lookup import body_number as body_number
    from carom.recording.read.lookup import names_of as names_of
    from carom.recording.schema.palette import LINES as LINES
    from carom.recording.schema.series import Plot as Plot
    from carom.recording.schema.series import Sample as Sample
    from carom.recording.schema.series import Series as Series
    from carom.scene.contact_laws import ContactLaw as ContactLaw
    from carom.scene.data import Arrays as Arrays
    from carom.scene.data import DataFormat as DataFormat
    from carom.scene.data import DataTable as DataTable
    from carom.scene.installed_forces import BodyForce as BodyForce
    from carom.scene.installed_forces import PairForce as PairForce
    from carom.scene.integrators import Integrator as Integrator
    from carom.scene.integrators import Substep as Substep
    from carom.scene.schema import Coefficients as Coefficients
    from carom.scene.schema.quantity import Count as Count
    from carom.scene.schema.quantity import Friction as Friction
    from carom.scene.schema.quantity import NonNegative as NonNegative
    from carom.scene.schema.quantity import Positive as Positive
    from carom.scene.schema.quantity import Real as Real
    from carom.scene.schema.quantity import Section as Section
    from carom.scene.units.dimension import ACCELERATION as ACCELERATION
    from carom.scene.units.dimension import ANGULAR_VELOCITY as ANGULAR_VELOCITY
    from carom.scene.units.dimension import DENSITY as DENSITY
    from carom.scene.units.dimension import ENERGY as ENERGY
    from carom.scene.units.dimension import FORCE as FORCE
    from carom.scene.units.dimension import IMPULSE as IMPULSE
    from carom.scene.units.dimension import LENGTH as LENGTH
    from carom.scene.units.dimension import MASS as MASS
    from carom.scene.units.dimension import RATE as RATE
    from carom.scene.units.dimension import TIME as TIME
    from carom.scene.units.dimension import TORQUE as TORQUE
    from carom.scene.units.dimension import VELOCITY as VELOCITY
    from carom.scene.units.dimension import Dimension as Dimension
    from carom.scene.units.system import SI as SI
    from carom.scene.units.system import UnitSystem as UnitSystem
    from carom.scene.wall_shapes import Facets as Facets
    from carom.scene.wall_shapes import Mesh as Mesh
    from carom.scene.wall_shapes import WallShape as WallShape
    from carom.scene.wall_shapes import across as across
    from carom.scene.wall_shapes import mesh_of_revolution as mesh_of_revolution
    from carom.scene.wall_shapes import unit_vector as unit_vector
    from carom.scene.wording import command as command
    from carom.scene.wording import counted as counted
    from carom.scene.wording import suggestion as suggestion
    from carom.terminal.compilation import announce_compilation as announce_compilation
    from carom.terminal.console import LiveLine as LiveLine
    from carom.terminal.console import Terminal as Terminal
    from carom.terminal.console import print_whole as print_whole
    from carom.terminal.options import ForceOption as ForceOption
    from carom.terminal.options import JsonOption as JsonOption
    from carom.terminal.options import OptionalTime as OptionalTime
    from carom.terminal.options import RecordingArgument as RecordingArgument
    from carom.terminal.options import SceneArgument as SceneArgument
    from carom.terminal.options import SetOption as SetOption
    from carom.terminal.options import ThreadsOption as ThreadsOption
    from carom.terminal.options import output_option as output_option
    from carom.terminal.options import recording_option as recording_option
    from carom.terminal.options import simulated as simulated
    from carom.terminal.options import simulated_or_none as simulated_or_none
    from carom.terminal.options import time_option as time_option
    from carom.terminal.printing import duration_text as duration_text
    from carom.terminal.printing import say as say
    from carom.terminal.printing import say_json as say_json

_NAMES = {  # names in each module
    "carom.errors": "needing",
    "carom.lab.compared_run": "Setting Trajectory",
    "carom.engines.engine": "Engine EngineSimulation Problem SteppedEngine dt_of problem_of refuse",
    "carom.physics.exponential": "exponential logarithm power",
    "carom.physics.jit.decorators": "kernel",
    "carom.recording.edit.bundle": "opened",
    "carom.recording.export": "Snapshot StepFiles TableFiles",
    "carom.recording.read.lookup": "body_number names_of",
    "carom.recording.schema.palette": "LINES",
    "carom.recording.schema.series": "Plot Sample Series",
    "carom.engines.source": "engine_package named_version",
    "carom.scene.contact_laws": "ContactLaw",
    "carom.scene.data": "Arrays DataFormat DataTable",
    "carom.scene.installed_forces": "BodyForce PairForce",
    "carom.scene.integrators": "Integrator Substep",
    "carom.scene.schema": "Coefficients",
    "carom.scene.schema.quantity": "Count Friction NonNegative Positive Real Section",
    "carom.scene.units.dimension": (
        "ACCELERATION ANGULAR_VELOCITY DENSITY Dimension ENERGY FORCE IMPULSE LENGTH MASS RATE TIME TORQUE VELOCITY"
    ),
    "carom.scene.units.system": "SI UnitSystem",
    "carom.scene.wall_shapes": "Facets Mesh WallShape across mesh_of_revolution unit_vector",
    "carom.scene.wording": "command counted suggestion",
    "carom.terminal.compilation": "announce_compilation",
    "carom.terminal.console": "LiveLine Terminal print_whole",
    "carom.terminal.options": (
        "ForceOption JsonOption OptionalTime RecordingArgument SceneArgument SetOption ThreadsOption "
        "output_option recording_option simulated simulated_or_none time_option"
    ),
    "carom.terminal.printing": "duration_text say say_json",
}
_HOMES = {name: module for module, names in _NAMES.items() for name in names.split()}


def __getattr__(name: str) -> Any:
    """Import a name at its first use."""
    if name not in _HOMES:
        raise AttributeError(f"module 'carom.extend' has no attribute {name!r}")
    return getattr(importlib.import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    """Return all names, used or not."""
    return sorted(_HOMES)
