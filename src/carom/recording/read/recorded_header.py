"""Reads the header of a run back from its recording."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from carom.recording.read.materials import materials_of
from carom.recording.read.recording import Recording
from carom.recording.schema import paths
from carom.recording.schema.header import Header
from carom.recording.style.colouring import COLOUR_BY
from carom.scene.forces import FORCES


def header_of_recording(recording: Recording) -> Header:
    """Return the header of a recorded run, as far as the file has it."""
    info, bodies = recording.info, recording.bodies
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
        forces=frozenset(kind.name for kind in FORCES if info.get(kind.present)),
        collides=bool(info["collides"]),
        stabilises=bool(info.get("stabilises", info["collides"])),
        body_colouring=bool(info["body_colouring"]),
        colour_by=_colour_by(info),
        materials=materials_of(recording),
        duration=float(info["duration"]),
        shortest_dt_hint=0.0,
        units=recording.units,
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
