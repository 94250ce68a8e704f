"""The interface for authors of extensions and of the tools in `carom.lab`, in addition to that of `carom`.

An extension is a package that names its parts in its ``pyproject.toml``, as `carom.registry` describes;
``examples/extension`` has parts of most kinds. docs/extending.md lists the names by purpose. They are imported at their
first use, so that a command starts as fast as those of carom.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from carom.display import keeper as keeper
    from carom.display import overlays as overlays
    from carom.display.catalog import serve_catalog as serve_catalog
    from carom.display.causes import CauseEdge as CauseEdge
    from carom.display.causes import Causes as Causes
    from carom.display.causes import write_causes as write_causes
    from carom.display.overlays import Forecast as Forecast
    from carom.display.overlays import write_forecast as write_forecast
    from carom.display.request import named_event as named_event
    from carom.errors import needing as needing
    from carom.physics.bodies import Bodies as Bodies
    from carom.physics.checkpoint import Checkpoint as Checkpoint
    from carom.physics.contact.law import LAW as LAW
    from carom.physics.diagnostics.extremes import Extremes as Extremes
    from carom.physics.exponential import exponential as exponential
    from carom.physics.exponential import logarithm as logarithm
    from carom.physics.exponential import power as power
    from carom.physics.forces.kernel_forces import forces_of_packages as forces_of_packages
    from carom.physics.jit import cores as cores
    from carom.physics.jit.decorators import kernel as kernel
    from carom.physics.look_ahead.find_step import with_promise as with_promise
    from carom.physics.placement import place as place
    from carom.physics.reference_api import BodyProxy as BodyProxy
    from carom.physics.reference_api import CollisionContext as CollisionContext
    from carom.physics.schedule import Every as Every
    from carom.physics.schedule import Schedule as Schedule
    from carom.physics.schedule import at as at
    from carom.physics.schedule import every as every
    from carom.physics.simulation import StepStatus as StepStatus
    from carom.physics.vector import minimum_images as minimum_images
    from carom.plan import auto as auto
    from carom.plan.features import Requirements as Requirements
    from carom.plan.features import require as require
    from carom.plan.hierarchy import DOMINANT as DOMINANT
    from carom.plan.hierarchy import why_no_hierarchy as why_no_hierarchy
    from carom.plan.interactions import damping as damping
    from carom.plan.interactions import further as further
    from carom.recording.edit.bundle import is_bundle as is_bundle
    from carom.recording.edit.bundle import opened as opened
    from carom.recording.export import Snapshot as Snapshot
    from carom.recording.read.first_difference import other_bits as other_bits
    from carom.recording.read.frame_rows import RecordedPositions as RecordedPositions
    from carom.recording.read.lookup import body_number as body_number
    from carom.recording.read.lookup import names_of as names_of
    from carom.recording.read.lookup import tolerance as tolerance
    from carom.recording.read.recorded_contacts import closing_speeds as closing_speeds
    from carom.recording.read.recorded_contacts import rows_by_frame as rows_by_frame
    from carom.recording.read.recorded_impacts import count_at as count_at
    from carom.recording.read.recorded_impacts import impacts_by_number as impacts_by_number
    from carom.recording.read.recorded_impacts import sums_between as sums_between
    from carom.recording.read.recorded_scene import RecordedBodies as RecordedBodies
    from carom.recording.read.recorded_scene import recorded_scene as recorded_scene
    from carom.recording.read.recorded_scene import start_of as start_of
    from carom.recording.schema.header import SweepMember as SweepMember
    from carom.recording.schema.palette import LINES as LINES
    from carom.recording.schema.paths import STEP as STEP
    from carom.recording.schema.series import Plot as Plot
    from carom.recording.schema.series import Sample as Sample
    from carom.recording.schema.series import Series as Series
    from carom.recording.source import SPHERE as SPHERE
    from carom.recording.source import engine_package as engine_package
    from carom.recording.source import named_version as named_version
    from carom.recording.source import setup_of as setup_of
    from carom.recording.source.observer import Observer as Observer
    from carom.recording.source.observer import not_finite as not_finite
    from carom.recording.write.durable_sink import DiskReserve as DiskReserve
    from carom.recording.write.whole_file import is_link_of_another as is_link_of_another
    from carom.recording.write.whole_file import new_name as new_name
    from carom.recording.write.whole_file import output_folder as output_folder
    from carom.recording.write.whole_file import refuse_itself as refuse_itself
    from carom.recording.write.whole_file import refuse_output as refuse_output
    from carom.recording.write.whole_file import refuse_scene_output as refuse_scene_output
    from carom.recording.write.whole_file import whole_file as whole_file
    from carom.recording.write.whole_file import write_whole as write_whole
    from carom.runs.environment import Interrupts as Interrupts
    from carom.runs.environment import command_line as command_line
    from carom.runs.environment import environment as environment
    from carom.runs.environment import versions as versions
    from carom.runs.outcome import Verdict as Verdict
    from carom.runs.outcome import in_words as in_words
    from carom.runs.outcome import judge as judge
    from carom.runs.refinement import refine as refine
    from carom.runs.resume import continued_scene as continued_scene
    from carom.runs.run import Outcome as Outcome
    from carom.runs.run import Watcher as Watcher
    from carom.runs.run import closing_summary as closing_summary
    from carom.runs.run import recording_space as recording_space
    from carom.runs.run import simulate as simulate
    from carom.runs.snapshot_writer import observed_recording as observed_recording
    from carom.runs.snapshot_writer import observed_totals as observed_totals
    from carom.runs.window import checkpoint_before as checkpoint_before
    from carom.runs.window import space_of as space_of
    from carom.runs.workers import Ended as Ended
    from carom.runs.workers import LocalWorkers as LocalWorkers
    from carom.runs.workers import TaskDroppedError as TaskDroppedError
    from carom.runs.workers import WorkerDiedError as WorkerDiedError
    from carom.runs.workers import Workers as Workers
    from carom.scene import variation as variation
    from carom.scene.contact_laws import DEFAULT_LAW as DEFAULT_LAW
    from carom.scene.contact_laws import ContactLaw as ContactLaw
    from carom.scene.conversion import converted as converted
    from carom.scene.conversion import rescaled as rescaled
    from carom.scene.data import Arrays as Arrays
    from carom.scene.data import DataFormat as DataFormat
    from carom.scene.data import DataTable as DataTable
    from carom.scene.data.body_sources import DataFiles as DataFiles
    from carom.scene.data.body_sources import HeldBodies as HeldBodies
    from carom.scene.forces import BodyForce as BodyForce
    from carom.scene.forces import PairForce as PairForce
    from carom.scene.integrators import INTEGRATORS as INTEGRATORS
    from carom.scene.integrators import Integrator as Integrator
    from carom.scene.integrators import Substep as Substep
    from carom.scene.integrators import integrator_called as integrator_called
    from carom.scene.load import scene_from_text as scene_from_text
    from carom.scene.matter import body_materials as body_materials
    from carom.scene.matter import pair_coefficients as pair_coefficients
    from carom.scene.parts import PARTS as PARTS
    from carom.scene.scene_file import DEEPEST as DEEPEST
    from carom.scene.scene_file import RECORDED as RECORDED
    from carom.scene.scene_file import bundled_folders as bundled_folders
    from carom.scene.scene_file import is_too_deep as is_too_deep
    from carom.scene.scene_file import line_of_long_key as line_of_long_key
    from carom.scene.scene_file import toml_for as toml_for
    from carom.scene.scene_file import toml_text as toml_text
    from carom.scene.schema import Coefficients as Coefficients
    from carom.scene.schema.contact import DEFAULT as DEFAULT
    from carom.scene.schema.promise import Expect as Expect
    from carom.scene.schema.quantity import Count as Count
    from carom.scene.schema.quantity import Friction as Friction
    from carom.scene.schema.quantity import NonNegative as NonNegative
    from carom.scene.schema.quantity import Positive as Positive
    from carom.scene.schema.quantity import Real as Real
    from carom.scene.schema.quantity import Section as Section
    from carom.scene.start import HalfSpaces as HalfSpaces
    from carom.scene.start import InitialBodies as InitialBodies
    from carom.scene.start import half_spaces as half_spaces
    from carom.scene.start import names_of_solids as names_of_solids
    from carom.scene.units.dimension import ACCELERATION as ACCELERATION
    from carom.scene.units.dimension import ANGULAR_VELOCITY as ANGULAR_VELOCITY
    from carom.scene.units.dimension import BASE as BASE
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
    from carom.scene.units.dimension import Physical as Physical
    from carom.scene.units.dimension import nearest_float as nearest_float
    from carom.scene.units.dimension import physical as physical
    from carom.scene.units.system import SI as SI
    from carom.scene.units.system import WITHOUT as WITHOUT
    from carom.scene.units.system import UnitSystem as UnitSystem
    from carom.scene.units.system import units_of_rebound as units_of_rebound
    from carom.scene.wall_shapes import Mesh as Mesh
    from carom.scene.wall_shapes import WallShape as WallShape
    from carom.scene.wall_shapes import across as across
    from carom.scene.wall_shapes import mesh_of_revolution as mesh_of_revolution
    from carom.scene.wall_shapes import unit_vector as unit_vector
    from carom.scene.wording import Names as Names
    from carom.scene.wording import bodies_called as bodies_called
    from carom.scene.wording import body_called as body_called
    from carom.scene.wording import command as command
    from carom.scene.wording import counted as counted
    from carom.scene.wording import literal as literal
    from carom.scene.wording import nearest as nearest
    from carom.scene.wording import suggestion as suggestion
    from carom.sharing.report import report as report
    from carom.terminal.compilation import announce_compilation as announce_compilation
    from carom.terminal.console import LiveLine as LiveLine
    from carom.terminal.console import Terminal as Terminal
    from carom.terminal.console import bar as bar
    from carom.terminal.console import print_whole as print_whole
    from carom.terminal.console import replaying as replaying
    from carom.terminal.options import ForceOption as ForceOption
    from carom.terminal.options import JsonOption as JsonOption
    from carom.terminal.options import OptionalTime as OptionalTime
    from carom.terminal.options import RecordingArgument as RecordingArgument
    from carom.terminal.options import SceneArgument as SceneArgument
    from carom.terminal.options import SetOption as SetOption
    from carom.terminal.options import ThreadsOption as ThreadsOption
    from carom.terminal.options import bundled as bundled
    from carom.terminal.options import not_a_folder as not_a_folder
    from carom.terminal.options import output_option as output_option
    from carom.terminal.options import recording_option as recording_option
    from carom.terminal.options import seconds as seconds
    from carom.terminal.options import simulated as simulated
    from carom.terminal.options import simulated_or_none as simulated_or_none
    from carom.terminal.options import time_option as time_option
    from carom.terminal.options import work_time as work_time
    from carom.terminal.printing import duration_text as duration_text
    from carom.terminal.printing import finite as finite
    from carom.terminal.printing import say as say
    from carom.terminal.printing import say_json as say_json

_NAMES = {  # of each module; docs/extending.md lists them by purpose
    "carom.terminal.options": (
        "ForceOption JsonOption OptionalTime RecordingArgument SceneArgument SetOption ThreadsOption bundled "
        "not_a_folder output_option recording_option seconds simulated simulated_or_none time_option work_time"
    ),
    "carom.terminal.printing": "duration_text finite say say_json",
    "carom.terminal.compilation": "announce_compilation",
    "carom.terminal.console": "LiveLine Terminal bar print_whole replaying",
    "carom.errors": "needing",
    "carom.physics.bodies": "Bodies",
    "carom.physics.checkpoint": "Checkpoint",
    "carom.physics.contact.law": "LAW",
    "carom.physics.diagnostics.extremes": "Extremes",
    "carom.physics.exponential": "exponential logarithm power",
    "carom.physics.forces.kernel_forces": "forces_of_packages",
    "carom.physics.jit": "cores",
    "carom.physics.jit.decorators": "kernel",
    "carom.physics.look_ahead.find_step": "with_promise",
    "carom.physics.placement": "place",
    "carom.physics.reference_api": "BodyProxy CollisionContext",
    "carom.physics.schedule": "Every Schedule at every",
    "carom.physics.simulation": "StepStatus",
    "carom.physics.vector": "minimum_images",
    "carom.plan": "auto",
    "carom.plan.features": "Requirements require",
    "carom.plan.hierarchy": "DOMINANT why_no_hierarchy",
    "carom.plan.interactions": "damping further",
    "carom.recording.edit.bundle": "is_bundle opened",
    "carom.recording.export": "Snapshot",
    "carom.recording.read.first_difference": "other_bits",
    "carom.recording.read.frame_rows": "RecordedPositions",
    "carom.recording.read.lookup": "body_number names_of tolerance",
    "carom.recording.read.recorded_contacts": "closing_speeds rows_by_frame",
    "carom.recording.read.recorded_impacts": "count_at impacts_by_number sums_between",
    "carom.recording.read.recorded_scene": "RecordedBodies recorded_scene start_of",
    "carom.recording.schema.header": "SweepMember",
    "carom.recording.schema.palette": "LINES",
    "carom.recording.schema.paths": "STEP",
    "carom.recording.schema.series": "Plot Sample Series",
    "carom.recording.source": "SPHERE engine_package named_version setup_of",
    "carom.recording.source.observer": "Observer not_finite",
    "carom.recording.write.durable_sink": "DiskReserve",
    "carom.recording.write.whole_file": (
        "is_link_of_another new_name output_folder refuse_itself refuse_output refuse_scene_output whole_file "
        "write_whole"
    ),
    "carom.runs.environment": "Interrupts command_line environment versions",
    "carom.runs.outcome": "Verdict in_words judge",
    "carom.runs.refinement": "refine",
    "carom.sharing.report": "report",
    "carom.runs.resume": "continued_scene",
    "carom.runs.run": "Outcome Watcher closing_summary recording_space simulate",
    "carom.runs.snapshot_writer": "observed_recording observed_totals",
    "carom.runs.window": "checkpoint_before space_of",
    "carom.runs.workers": "Ended LocalWorkers TaskDroppedError WorkerDiedError Workers",
    "carom.scene": "variation",
    "carom.scene.contact_laws": "DEFAULT_LAW ContactLaw",
    "carom.scene.conversion": "converted rescaled",
    "carom.scene.data": "Arrays DataFormat DataTable",
    "carom.scene.data.body_sources": "DataFiles HeldBodies",
    "carom.scene.forces": "BodyForce PairForce",
    "carom.scene.integrators": "INTEGRATORS Integrator Substep integrator_called",
    "carom.scene.load": "scene_from_text",
    "carom.scene.matter": "body_materials pair_coefficients",
    "carom.scene.parts": "PARTS",
    "carom.scene.scene_file": "DEEPEST RECORDED bundled_folders is_too_deep line_of_long_key toml_for toml_text",
    "carom.scene.schema": "Coefficients",
    "carom.scene.schema.contact": "DEFAULT",
    "carom.scene.schema.promise": "Expect",
    "carom.scene.schema.quantity": "Count Friction NonNegative Positive Real Section",
    "carom.scene.start": "HalfSpaces InitialBodies half_spaces names_of_solids",
    "carom.scene.units.dimension": (
        "ACCELERATION ANGULAR_VELOCITY BASE DENSITY ENERGY FORCE IMPULSE LENGTH MASS RATE TIME TORQUE VELOCITY "
        "Dimension Physical nearest_float physical"
    ),
    "carom.scene.units.system": "SI WITHOUT UnitSystem units_of_rebound",
    "carom.scene.wall_shapes": "Mesh WallShape across mesh_of_revolution unit_vector",
    "carom.scene.wording": "Names bodies_called body_called command counted literal nearest suggestion",
    "carom.display": "keeper overlays",
    "carom.display.catalog": "serve_catalog",
    "carom.display.causes": "CauseEdge Causes write_causes",
    "carom.display.overlays": "Forecast write_forecast",
    "carom.display.request": "named_event",
}
_HOMES = {name: module for module, names in _NAMES.items() for name in names.split()}


def __getattr__(name: str) -> Any:
    """Import a name at its first use."""
    if name not in _HOMES:
        raise AttributeError(f"module 'carom.extend' has no attribute {name!r}")
    home = importlib.import_module(_HOMES[name])
    return getattr(home, name) if hasattr(home, name) else importlib.import_module(f"{home.__name__}.{name}")


def __dir__() -> list[str]:
    """Return all names, used or not."""
    return sorted(_HOMES)
