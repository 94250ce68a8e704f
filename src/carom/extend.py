"""What authors of extensions and of the tools in `carom.lab` need, beside what `carom` itself exports.

An extension is a package that names its parts in its ``pyproject.toml``, as `carom.registry` describes;
``examples/extension`` has parts of most kinds. Names are imported at their first use, so that a command starts as fast
as those of carom.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from carom.cli.compiling import announce_compilation as announce_compilation
    from carom.cli.options import ForceOption as ForceOption
    from carom.cli.options import JsonOption as JsonOption
    from carom.cli.options import OptionalTime as OptionalTime
    from carom.cli.options import RecordingArgument as RecordingArgument
    from carom.cli.options import SceneArgument as SceneArgument
    from carom.cli.options import SetOption as SetOption
    from carom.cli.options import ThreadsOption as ThreadsOption
    from carom.cli.options import bundled as bundled
    from carom.cli.options import not_a_folder as not_a_folder
    from carom.cli.options import recording_option as recording_option
    from carom.cli.options import seconds as seconds
    from carom.cli.options import simulated as simulated
    from carom.cli.options import simulated_or_none as simulated_or_none
    from carom.cli.options import work_time as work_time
    from carom.cli.printing import duration_text as duration_text
    from carom.cli.printing import finite as finite
    from carom.cli.printing import say as say
    from carom.cli.printing import say_json as say_json
    from carom.cli.terminal import LiveLine as LiveLine
    from carom.cli.terminal import Terminal as Terminal
    from carom.cli.terminal import bar as bar
    from carom.cli.terminal import print_whole as print_whole
    from carom.cli.terminal import replaying as replaying
    from carom.install import needing as needing
    from carom.physics.bodies import Bodies as Bodies
    from carom.physics.checkpoint import Checkpoint as Checkpoint
    from carom.physics.contact.law import LAW as LAW
    from carom.physics.diagnostics.extremes import Extremes as Extremes
    from carom.physics.forces.kernel_forces import forces_of_packages as forces_of_packages
    from carom.physics.jit.cores import cores as cores
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
    from carom.plan.auto import auto_interval as auto_interval
    from carom.plan.auto import cfl as cfl
    from carom.plan.auto import frame_interval as frame_interval
    from carom.plan.auto import gravity_method as gravity_method
    from carom.plan.auto import integrator as integrator
    from carom.plan.auto import largest_step as largest_step
    from carom.plan.auto import pull_fraction as pull_fraction
    from carom.plan.auto import smoothing as smoothing
    from carom.plan.auto import target_dx as target_dx
    from carom.plan.auto import timing as timing
    from carom.plan.auto import uses_tree as uses_tree
    from carom.plan.features import Requirements as Requirements
    from carom.plan.features import require as require
    from carom.plan.hierarchy import DOMINANT as DOMINANT
    from carom.plan.hierarchy import why_no_hierarchy as why_no_hierarchy
    from carom.plan.pulls import damping as damping
    from carom.plan.pulls import further as further
    from carom.recording.edit.bundle import is_bundle as is_bundle
    from carom.recording.edit.bundle import opened as opened
    from carom.recording.export.export import Snapshot as Snapshot
    from carom.recording.read.body_lookup import body_number as body_number
    from carom.recording.read.body_lookup import names_of as names_of
    from carom.recording.read.frame_rows import RecordedPositions as RecordedPositions
    from carom.recording.read.moment import tolerance as tolerance
    from carom.recording.read.recorded_impacts import count_at as count_at
    from carom.recording.read.recorded_impacts import impacts_by_number as impacts_by_number
    from carom.recording.read.recorded_scene import RecordedBodies as RecordedBodies
    from carom.recording.read.recorded_scene import recorded_scene as recorded_scene
    from carom.recording.read.recorded_scene import start_of as start_of
    from carom.recording.schema.header import Header as Header
    from carom.recording.schema.header import Scalar as Scalar
    from carom.recording.schema.header import SweepMember as SweepMember
    from carom.recording.schema.palette import LINES as LINES
    from carom.recording.schema.paths import STEP as STEP
    from carom.recording.schema.series import Past as Past
    from carom.recording.schema.series import Plot as Plot
    from carom.recording.schema.series import Sample as Sample
    from carom.recording.schema.series import Series as Series
    from carom.recording.source.adapters.box3d_source import PACKAGE as PACKAGE
    from carom.recording.source.adapters.box3d_source import box3d as box3d
    from carom.recording.source.adapters.mujoco_source import mujoco as mujoco
    from carom.recording.source.adapters.newton_source import newton as newton
    from carom.recording.source.adapters.package import engine_package as engine_package
    from carom.recording.source.adapters.pybullet_source import pybullet as pybullet
    from carom.recording.source.adapters.rebound_source import rebound as rebound
    from carom.recording.source.law_audit import Fault as Fault
    from carom.recording.source.law_audit import Tolerances as Tolerances
    from carom.recording.source.observer import Observer as Observer
    from carom.recording.source.observer import header_of_source as header_of_source
    from carom.recording.source.observer import not_finite as not_finite
    from carom.recording.source.source import SPHERE as SPHERE
    from carom.recording.source.source import Model as Model
    from carom.recording.source.source import Plane as Plane
    from carom.recording.source.source import Setup as Setup
    from carom.recording.source.source import Source as Source
    from carom.recording.source.source import State as State
    from carom.recording.source.source import StateMemory as StateMemory
    from carom.recording.source.source import SteppedSource as SteppedSource
    from carom.recording.source.source import array_of as array_of
    from carom.recording.source.source import memory_of as memory_of
    from carom.recording.source.source import reader_of as reader_of
    from carom.recording.source.source import refuse_no_rotation as refuse_no_rotation
    from carom.recording.source.source import setup_of as setup_of
    from carom.recording.source.source import time_of as time_of
    from carom.recording.write.durable_sink import DiskReserve as DiskReserve
    from carom.recording.write.recorder import FrameRecorder as FrameRecorder
    from carom.recording.write.whole_file import new_name as new_name
    from carom.recording.write.whole_file import whole_file as whole_file
    from carom.recording.write.whole_file import write_whole as write_whole
    from carom.runs.environment import command_line as command_line
    from carom.runs.environment import environment as environment
    from carom.runs.environment import versions as versions
    from carom.runs.outcome import Verdict as Verdict
    from carom.runs.outcome import closing_of as closing_of
    from carom.runs.outcome import judge as judge
    from carom.runs.output import claimed_output as claimed_output
    from carom.runs.output import is_link_of_another as is_link_of_another
    from carom.runs.output import output_folder as output_folder
    from carom.runs.output import refuse_itself as refuse_itself
    from carom.runs.output import refuse_name as refuse_name
    from carom.runs.output import refuse_output as refuse_output
    from carom.runs.output import refuse_scene_output as refuse_scene_output
    from carom.runs.overview import ONCE_A_STEP as ONCE_A_STEP
    from carom.runs.overview import in_words as in_words
    from carom.runs.process_settings import Interrupts as Interrupts
    from carom.runs.report import report as report
    from carom.runs.resume import continued_scene as continued_scene
    from carom.runs.run import Outcome as Outcome
    from carom.runs.run import Watcher as Watcher
    from carom.runs.run import closing_summary as closing_summary
    from carom.runs.run import recording_space as recording_space
    from carom.runs.run import simulate as simulate
    from carom.runs.window import checkpoint_before as checkpoint_before
    from carom.runs.window import space_of as space_of
    from carom.runs.workers import Ended as Ended
    from carom.runs.workers import LocalWorkers as LocalWorkers
    from carom.runs.workers import TaskDroppedError as TaskDroppedError
    from carom.runs.workers import WorkerDiedError as WorkerDiedError
    from carom.runs.workers import Workers as Workers
    from carom.scene.contact_laws import DEFAULT_LAW as DEFAULT_LAW
    from carom.scene.contact_laws import ContactLaw as ContactLaw
    from carom.scene.conversion import converted as converted
    from carom.scene.conversion import rescaled as rescaled
    from carom.scene.data.body_sources import DataFiles as DataFiles
    from carom.scene.data.body_sources import HeldBodies as HeldBodies
    from carom.scene.data.formats import Arrays as Arrays
    from carom.scene.data.formats import DataFormat as DataFormat
    from carom.scene.data.formats import DataTable as DataTable
    from carom.scene.forces import BodyForce as BodyForce
    from carom.scene.forces import PairForce as PairForce
    from carom.scene.integrators import INTEGRATORS as INTEGRATORS
    from carom.scene.integrators import Integrator as Integrator
    from carom.scene.integrators import Substep as Substep
    from carom.scene.integrators import integrator_called as integrator_called
    from carom.scene.key_places import DEEPEST as DEEPEST
    from carom.scene.key_places import is_too_deep as is_too_deep
    from carom.scene.key_places import line_of_long_key as line_of_long_key
    from carom.scene.load import load_scene as load_scene
    from carom.scene.load import scene_from_dict as scene_from_dict
    from carom.scene.load import scene_from_text as scene_from_text
    from carom.scene.matter import body_materials as body_materials
    from carom.scene.matter import pair_coefficients as pair_coefficients
    from carom.scene.parts import PARTS as PARTS
    from carom.scene.scene_file import RECORDED as RECORDED
    from carom.scene.scene_file import bundled_folders as bundled_folders
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
    from carom.scene.toml_text import toml_for as toml_for
    from carom.scene.toml_text import toml_text as toml_text
    from carom.scene.units.dimension import ACCELERATION as ACCELERATION
    from carom.scene.units.dimension import ANGULAR_VELOCITY as ANGULAR_VELOCITY
    from carom.scene.units.dimension import BASE as BASE
    from carom.scene.units.dimension import DENSITY as DENSITY
    from carom.scene.units.dimension import ENERGY as ENERGY
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
    from carom.scene.units.unit import Physical as Physical
    from carom.scene.units.unit import UnitError as UnitError
    from carom.scene.units.unit import nearest_float as nearest_float
    from carom.scene.units.unit import physical as physical
    from carom.scene.variation import MOST_RUNS as MOST_RUNS
    from carom.scene.variation import TOO_MANY_RUNS as TOO_MANY_RUNS
    from carom.scene.variation import Values as Values
    from carom.scene.variation import combinations as combinations
    from carom.scene.variation import override as override
    from carom.scene.variation import texts_of as texts_of
    from carom.scene.variation import values_of as values_of
    from carom.scene.wording import Names as Names
    from carom.scene.wording import bodies_called as bodies_called
    from carom.scene.wording import command as command
    from carom.scene.wording import counted as counted
    from carom.scene.wording import nearest as nearest
    from carom.scene.wording import suggestion as suggestion
    from carom.show.catalog import serve_catalog as serve_catalog
    from carom.show.causes import CauseEdge as CauseEdge
    from carom.show.causes import Causes as Causes
    from carom.show.causes import write_causes as write_causes
    from carom.show.forecast import Forecast as Forecast
    from carom.show.forecast import write_forecast as write_forecast
    from carom.show.keeper import has_screen as has_screen
    from carom.show.keeper import isolate as isolate
    from carom.show.keeper import screen_is_remote as screen_is_remote
    from carom.show.overlays import ComparedTrajectory as ComparedTrajectory
    from carom.show.overlays import MatchedFrames as MatchedFrames
    from carom.show.overlays import write_overlay as write_overlay
    from carom.show.overlays import write_trajectories as write_trajectories
    from carom.show.request import named_event as named_event

_HOMES = {
    "carom.scene.conversion": "converted rescaled",
    "carom.scene.data.body_sources": "DataFiles HeldBodies",
    "carom.scene.integrators": "INTEGRATORS Integrator Substep integrator_called",
    "carom.scene.key_places": "DEEPEST is_too_deep line_of_long_key",
    "carom.recording.export.export": "Snapshot",
    "carom.scene.contact_laws": "DEFAULT_LAW ContactLaw",
    "carom.scene.data.formats": "Arrays DataFormat DataTable",
    "carom.scene.forces": "BodyForce PairForce",
    "carom.scene.load": "load_scene scene_from_dict scene_from_text",
    "carom.scene.matter": "body_materials pair_coefficients",
    "carom.scene.parts": "PARTS",
    "carom.scene.scene_file": "RECORDED bundled_folders",
    "carom.scene.schema": "Coefficients",
    "carom.scene.schema.contact": "DEFAULT",
    "carom.scene.schema.promise": "Expect",
    "carom.scene.schema.quantity": "Count Friction NonNegative Positive Real Section",
    "carom.scene.start": "HalfSpaces InitialBodies half_spaces",
    "carom.scene.toml_text": "toml_for toml_text",
    "carom.scene.units.dimension": (
        "ACCELERATION ANGULAR_VELOCITY BASE DENSITY Dimension ENERGY IMPULSE LENGTH MASS RATE TIME TORQUE VELOCITY"
    ),
    "carom.scene.units.system": "SI UnitSystem",
    "carom.scene.units.unit": "Physical UnitError nearest_float physical",
    "carom.scene.variation": "MOST_RUNS TOO_MANY_RUNS Values combinations override texts_of values_of",
    "carom.scene.wording": "Names bodies_called command counted nearest suggestion",
    "carom.plan.auto": (
        "auto_interval cfl frame_interval gravity_method integrator largest_step pull_fraction smoothing target_dx "
        "timing uses_tree"
    ),
    "carom.plan.features": "Requirements require",
    "carom.plan.hierarchy": "DOMINANT why_no_hierarchy",
    "carom.plan.pulls": "damping further",
    "carom.physics.bodies": "Bodies",
    "carom.physics.checkpoint": "Checkpoint",
    "carom.physics.contact.law": "LAW",
    "carom.physics.diagnostics.extremes": "Extremes",
    "carom.physics.look_ahead.find_step": "with_promise",
    "carom.physics.forces.kernel_forces": "forces_of_packages",
    "carom.physics.jit.cores": "cores",
    "carom.physics.jit.decorators": "kernel",
    "carom.physics.vector": "minimum_images",
    "carom.physics.placement": "place",
    "carom.physics.reference_api": "BodyProxy CollisionContext",
    "carom.physics.schedule": "Every Schedule at every",
    "carom.physics.simulation": "StepStatus",
    "carom.recording.edit.bundle": "is_bundle opened",
    "carom.recording.read.body_lookup": "body_number names_of",
    "carom.recording.read.frame_rows": "RecordedPositions",
    "carom.recording.read.recorded_impacts": "count_at impacts_by_number",
    "carom.recording.read.moment": "tolerance",
    "carom.recording.read.recorded_scene": "RecordedBodies recorded_scene start_of",
    "carom.recording.schema.header": "Header Scalar SweepMember",
    "carom.recording.schema.palette": "LINES",
    "carom.recording.schema.paths": "STEP",
    "carom.recording.schema.series": "Past Plot Sample Series",
    "carom.recording.source.adapters.box3d_source": "PACKAGE box3d",
    "carom.recording.source.adapters.mujoco_source": "mujoco",
    "carom.recording.source.adapters.newton_source": "newton",
    "carom.recording.source.adapters.package": "engine_package",
    "carom.recording.source.adapters.pybullet_source": "pybullet",
    "carom.recording.source.adapters.rebound_source": "rebound",
    "carom.recording.source.law_audit": "Fault Tolerances",
    "carom.recording.source.observer": "Observer header_of_source not_finite",
    "carom.recording.source.source": (
        "Model Plane SPHERE Setup Source State StateMemory SteppedSource array_of memory_of reader_of "
        "refuse_no_rotation setup_of time_of"
    ),
    "carom.recording.write.durable_sink": "DiskReserve",
    "carom.recording.write.recorder": "FrameRecorder",
    "carom.recording.write.whole_file": "new_name whole_file write_whole",
    "carom.runs.outcome": "closing_of Verdict judge",
    "carom.runs.overview": "ONCE_A_STEP in_words",
    "carom.runs.resume": "continued_scene",
    "carom.runs.environment": "command_line environment versions",
    "carom.runs.process_settings": "Interrupts",
    "carom.cli.printing": "finite say_json say duration_text",
    "carom.runs.output": (
        "claimed_output is_link_of_another output_folder refuse_itself refuse_name refuse_output refuse_scene_output"
    ),
    "carom.runs.report": "report",
    "carom.runs.run": "Outcome Watcher closing_summary recording_space simulate",
    "carom.runs.window": "checkpoint_before space_of",
    "carom.runs.workers": "Ended LocalWorkers TaskDroppedError WorkerDiedError Workers",
    "carom.show.catalog": "serve_catalog",
    "carom.show.causes": "CauseEdge Causes write_causes",
    "carom.show.forecast": "Forecast write_forecast",
    "carom.show.keeper": "has_screen isolate screen_is_remote",
    "carom.show.request": "named_event",
    "carom.show.overlays": "ComparedTrajectory MatchedFrames write_overlay write_trajectories",
    "carom.cli.compiling": "announce_compilation",
    "carom.install": "needing",
    "carom.cli.terminal": "LiveLine bar replaying Terminal print_whole",
    "carom.cli.options": (
        "ForceOption JsonOption OptionalTime RecordingArgument SceneArgument SetOption ThreadsOption bundled "
        "not_a_folder recording_option seconds simulated simulated_or_none work_time"
    ),
}
_PLACES = {name: home for home, names in _HOMES.items() for name in names.split()}


def __getattr__(name: str) -> Any:
    """Import a name at its first use."""
    if name not in _PLACES:
        raise AttributeError(f"module 'carom.extend' has no attribute {name!r}")
    return getattr(importlib.import_module(_PLACES[name]), name)


def __dir__() -> list[str]:
    """Return the names, whether they have been used or not."""
    return sorted(_PLACES)
