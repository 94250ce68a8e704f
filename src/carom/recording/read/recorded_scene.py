"""The scene of a recording, and the header and the outlines of plots for a new layout.

A recording may come from a stranger, so all data are checked before use.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa

from carom.arrays import BoolArray
from carom.errors import RecordingError, SceneError
from carom.recording.read.entities import SCALARS, flat
from carom.recording.schema import paths
from carom.recording.schema.curve_outline import CurveOutline
from carom.recording.schema.header import COLOUR_BY, Header, ShownMaterials, motions_of, scene_digest
from carom.recording.schema.paths import ENERGY, STEPS
from carom.recording.schema.properties import fields_read
from carom.recording.schema.series import all_series, outlet_series, piston_series
from carom.recording.timelines import SIM_TIME, STEP
from carom.scene.data.body_sources import SourcedBodies, Wanted
from carom.scene.extensions import missing, names_of, stamped
from carom.scene.forces import FORCES
from carom.scene.load import Scene, longest_text, scene_from_text
from carom.scene.start import EntryStates, InitialBodies, planes_of
from carom.state.checkpoint import Checkpoint

if TYPE_CHECKING:
    from carom.recording.read.recorded_data import RecordedData


def recorded_scene(recording: RecordedData, overrides: list[str] | None = None) -> Scene:
    """Return the scene of a recording. Raises SceneError if this version cannot read it.

    Raises RecordingError if the recording is damaged, comes from another engine, or is a clip without exact states.
    """
    path = recording.path
    if recording.engine:
        raise RecordingError(f"{path} was recorded from {recording.engine}: carom cannot rerun another engine")
    if recording.is_partial:
        part = f"a clip of {len(recording.shown)} of {recording.info['bodies']} bodies without exact states"
        raise RecordingError(f"{path} is {part}: it cannot be rerun, but the recording from which it was cut can")
    text, bodies = recording.scene_toml, len(recording.bodies.mass)
    if len(text) > longest_text(bodies):
        raise RecordingError(f"{path} has a scene of {len(text)} characters for {bodies} bodies: it is damaged")
    stated = recording.info.get("scene_sha256")
    if stated != scene_digest(text):
        altered = "its scene was altered after the recording (the SHA-256 differs)"
        raise RecordingError(f"{path}: {altered}, so it cannot be rerun")
    refuse_missing_extensions(recording)
    source = f"the scene in {path}"
    scene = scene_from_text(text, source, bodies=RecordedBodies(recording))
    if overrides:
        scene = scene_from_text(text, source, overrides, scene.held)
    if scene.count != bodies:
        raise RecordingError(f"{path} has {bodies} bodies, but its scene has {scene.count}: it is damaged")
    return scene


def materials_of(recording: RecordedData) -> ShownMaterials | None:
    """Return the materials of a recording; None if the scene has none, or this version cannot read the scene."""
    if "material" not in recording.scene_toml:  # the scene is not parsed here, since that takes seconds for many bodies
        return None
    try:
        return ShownMaterials.of(recorded_scene(recording))
    except (RecordingError, SceneError):
        return None


def refuse_missing_extensions(recording: RecordedData) -> None:
    """Raise RecordingError, with the packages to install, if packages of the scene are missing."""
    if lack := missing(stamped(recording.info)):
        raise RecordingError(f"{recording.path}: {lack}")


class RecordedBodies:
    """Finds the bodies of [[bodies]] tables in a recording."""

    def __init__(self, recording: RecordedData) -> None:
        self._recording = recording

    def find(self, wanted: Wanted) -> SourcedBodies:
        """Return the bodies of a table; see `BodySource`."""
        section = wanted.section
        if self._recording.is_partial:
            raise SceneError("its bodies are not in this clip")
        if section.count is None or section.sha256 is None:
            raise SceneError("its count and sha256 are missing: the recording is damaged")
        place = range(wanted.first, wanted.first + section.count)
        notes = tuple(self._recording.data_notes(wanted.index))
        return SourcedBodies(self._recording.given_bodies(wanted.index, wanted.row, place), section.sha256, notes=notes)


def start_of(recording: RecordedData, scene: Scene, checkpoint: Checkpoint) -> InitialBodies:
    """Return the recorded bodies in the state of a checkpoint, or as they enter, if some enter during the run."""
    bodies, n = recording.bodies, scene.count
    spin = checkpoint.angular_velocity
    state = EntryStates(checkpoint.position, checkpoint.velocity, np.zeros((n, 3)) if spin is None else spin)
    position, velocity, angular_velocity = recording.entries or state
    return InitialBodies(
        name=bodies.name,
        group=bodies.group,
        position=position,
        velocity=velocity,
        angular_velocity=angular_velocity,
        mass=bodies.mass,
        radius=bodies.radius,
        inertia=bodies.inertia,
        fixed=fixed_of(scene),
    )


def fixed_of(scene: Scene) -> BoolArray:
    """Return a mask (n,) of the fixed bodies of a scene; bodies of groups are never fixed."""
    given = [np.array([body.fixed for body in scene.body], dtype=bool), *(columns.fixed for columns in scene.data)]
    fixed = np.concatenate(given)
    return np.pad(fixed, (0, scene.count - len(fixed)))


def header_of_recording(recording: RecordedData) -> Header:
    """Return the header of a recorded run, from the data that the file holds."""
    info, bodies = recording.info, recording.bodies
    extensions = stamped(info)
    static = {entry.entity_path for entry in recording.store.entries if entry.is_static}
    drives, scene = bool(info.get("drives", False)), None
    # the scene is read only if necessary, since that may take seconds
    if drives or "pistons" in info or "material" in recording.scene_toml:
        with suppress(RecordingError, SceneError):  # this version may be unable to read the scene
            scene = recorded_scene(recording)
    planes = None
    if paths.PLANES in static:  # planes as drawn, without sides; the motion of a piston needs the planes of the scene
        planes = planes_of(scene) if scene and "pistons" in info else recording.drawn_planes()
    colour_by = str(info["colour_by"]) if info["colour_by"] in COLOUR_BY else "auto"
    stated = fields_read(info) | {"title": recording.title, "colour_by": colour_by}
    return Header(
        description="",
        scene_toml=recording.scene_toml,
        run_id=recording.store.store_id,
        names=bodies.name,
        group=bodies.group,
        mass=bodies.mass,
        radius=bodies.radius[recording.shown],  # a clip may show only some bodies
        inertia=bodies.inertia,
        forces=frozenset((*(kind.name for kind in FORCES if info.get(kind.present)), *names_of("forces", extensions))),
        extensions=extensions,
        materials=None if scene is None else ShownMaterials.of(scene),
        shortest_dt_hint=0.0,
        units=recording.units,
        entries=recording.entries,
        pistons=recorded_pistons(info),
        outlets=outlets_of(info),
        drives=drives,
        motions=motions_of(scene) if scene and drives else {},
        shear=recording.shear,
        record_impacts="auto" if recording.records_contacts else "none",
        walls=recording.drawn_box(paths.WALLS) if paths.WALLS in static else None,
        shapes=(scene.wall if scene and drives else ()) if paths.SHAPES in static else None,
        planes=planes,
        **stated,
    )


def recorded_pistons(properties: Mapping[str, Any]) -> tuple[int, ...]:
    """Return the numbers of the planes that contacts move in a recording, from its properties."""
    return tuple(int(number) for number in str(properties.get("pistons", "")).split() if number.isdigit())


def outlets_of(properties: Mapping[str, Any]) -> list[str]:
    """Return the names of the outlets of a recording, from its properties."""
    return str(properties.get("outlets", "")).splitlines()


def recorded_curves(recording: RecordedData, until: int | None = None) -> dict[str, CurveOutline]:
    """Return the outlines of all plotted series by path, optionally only up to a step."""
    curves: dict[str, CurveOutline] = {}
    tables = {ENERGY: recording.energy(), STEPS: recording.steps()}
    pistons, outlets = len(recorded_pistons(recording.info)), outlets_of(recording.info)
    for series in (*all_series(stamped(recording.info)), *piston_series(pistons), *outlet_series(outlets)):
        table, name = tables[series.path.partition("/")[0]], series.path.rpartition("/")[2]
        if series.plot is not None and name in table.column_names:
            kept = slice(None) if until is None else table[STEP].to_numpy() <= until
            curves[series.path] = CurveOutline.of(table["time"].to_numpy()[kept], np.asarray(table[name])[kept])
    frames = recording.fingerprints()
    end = np.inf if until is None else frames["time"].to_numpy()[frames[STEP].to_numpy() <= until].max()
    scale = 1e-9 * float(recording.info["time_scale"])
    entries = [entry for entry in recording.store.entries if entry.is_within_steps and entry.entity_path in curves]
    for chunk in recording.chunks(entries):  # the values before and after impacts
        times = chunk.batch[SIM_TIME].cast(pa.int64()).to_numpy() * scale
        values = flat(chunk, "Scalars:scalars", SCALARS["Scalars:scalars"]).to_numpy()
        curves[chunk.entity_path].insert(times[times < end], values[times < end])
    return curves
