"""The header of a recorded run and the outlines of its plots, for a layout that is made after the run."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from carom.recording.layout.plot_views import CurveOutline
from carom.recording.read.recorded_scene import materials_of
from carom.recording.schema import paths
from carom.recording.schema.header import COLOUR_BY, Header
from carom.recording.schema.paths import ENERGY, STEP, STEPS
from carom.recording.schema.series import all_series
from carom.scene.extensions import names_of, stamped
from carom.scene.forces import FORCES

if TYPE_CHECKING:
    from carom.recording.read.recording import Recording


def header_of_recording(recording: Recording) -> Header:
    """Return the header of a recorded run, as far as the file has it."""
    info, bodies = recording.info, recording.bodies
    extensions = stamped(info)
    static = {entry.entity_path for entry in recording.store.entries if entry.is_static}
    return Header(
        title=recording.title,
        description="",
        scene_toml=recording.scene_toml,
        seed=int(info["seed"]),
        run_id=recording.store.store_id,
        names=bodies.name,
        group=bodies.group,
        mass=bodies.mass,
        radius=bodies.radius[recording.shown],  # a clip may show only some bodies
        inertia=bodies.inertia,
        spins=bool(info["spins"]),
        has_orientation=bool(info.get("has_orientation", info["spins"])),  # older recordings have one flag
        has_torque=bool(info.get("has_torque", info["spins"])),
        has_friction=bool(info.get("has_friction", info["spins"])),
        forces=frozenset((*(kind.name for kind in FORCES if info.get(kind.present)), *names_of("forces", extensions))),
        extensions=extensions,
        collides=bool(info["collides"]),
        stabilises=bool(info.get("stabilises", info["collides"])),
        body_colouring=bool(info["body_colouring"]),
        colour_by=_colour_by(info),
        materials=materials_of(recording),
        duration=float(info["duration"]),
        shortest_dt_hint=0.0,
        units=recording.units,
        check_interval=recording.check_interval,
        promises=bool(info.get("promises", False)),
        record_impacts="auto" if recording.records_contacts else "none",
        box=np.asarray(info["box"]) if "box" in info else None,
        walls=recording.drawn_box(paths.WALLS) if paths.WALLS in static else None,
        planes=recording.drawn_planes() if paths.PLANES in static else None,
        engine=recording.engine,
    )


def _colour_by(info: Mapping[str, Any]) -> str:
    """Return what the bodies are coloured by; older recordings do not store it."""
    known = str(info.get("colour_by", "auto"))
    return known if known in COLOUR_BY else "auto"


def recorded_curves(recording: Recording, until: int | None = None) -> dict[str, CurveOutline]:
    """Return the outlines of all recorded and plotted series, by their paths; up to a step if one is given."""
    curves: dict[str, CurveOutline] = {}
    tables = {ENERGY: recording.energy(), STEPS: recording.steps()}
    for series in all_series(stamped(recording.info)):
        table, name = tables[series.path.partition("/")[0]], series.path.rpartition("/")[2]
        if series.plot is not None and name in table.column_names:
            kept = slice(None) if until is None else table[STEP].to_numpy() <= until
            curves[series.path] = CurveOutline.of(table["time"].to_numpy()[kept], np.asarray(table[name])[kept])
    return curves
