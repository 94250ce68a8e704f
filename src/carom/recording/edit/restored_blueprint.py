"""Makes a layout for a recording without one: the run was killed before it sent one, or it was lost."""

from __future__ import annotations

import numpy as np
import rerun.blueprint as rrb

from carom.recording.read.recording import Recording
from carom.recording.schema import paths
from carom.recording.schema.header import Header
from carom.recording.view.blueprint import blueprint
from carom.recording.view.camera import CameraFit
from carom.scene.forces import FORCES
from carom.scene.half_space import HalfSpaces

_LOOKS = 50  # frames by which the camera is placed


def new_layout(recording: Recording) -> rrb.Blueprint:
    """Lay out a recording as the recorder would have done. RecordingError if too little of it is left."""
    header = _header(recording)
    entries = [e for e in recording.store.entries if e.entity_path == paths.BODIES and e.first_step is not None]
    entries = sorted(entries, key=lambda entry: entry.first_step or 0)
    some = [entries[k] for k in sorted(set(np.linspace(0, len(entries) - 1, _LOOKS).astype(int)))] if entries else []
    fit = None
    for chunk in recording.chunks(some):
        centres = next((chunk.batch[name] for name in paths.CENTRES if name in chunk.components), None)
        if centres is None:  # the component's name is damaged
            continue
        first, last = (centres[row].values.flatten().to_numpy().reshape(-1, 3) for row in (0, len(centres) - 1))
        fit = fit or CameraFit(header.radius[recording.shown], first)
        fit.look(last)
    if fit is None:
        fit = CameraFit(header.radius, np.zeros((header.bodies, 3)))
    return blueprint(header, fit.view())


def _header(recording: Recording) -> Header:
    info, bodies = recording.info, recording.bodies
    static = {entry.entity_path for entry in recording.store.entries if entry.is_static}
    nowhere = HalfSpaces([], np.zeros((0, 3)), np.zeros(0), np.zeros((0, 3)))
    return Header(
        title=recording.title,
        description="",
        scene_toml=recording.scene_toml,
        seed=int(info["seed"]),
        run_id=recording.store.store_id,
        names=bodies.name,
        group=bodies.group,
        mass=bodies.mass,
        radius=bodies.radius,
        inertia=bodies.inertia,
        spins=bool(info["spins"]),
        has_orientation=bool(info.get("has_orientation", info["spins"])),  # without it: recorded when all went together
        has_torque=bool(info.get("has_torque", info["spins"])),
        has_friction=bool(info.get("has_friction", info["spins"])),
        forces=frozenset(kind.name for kind in FORCES if info.get(kind.present)),
        collides=bool(info["collides"]),
        stabilises=bool(info.get("stabilises", info["collides"])),
        body_colouring=bool(info["body_colouring"]),
        duration=float(info["duration"]),
        shortest_dt_hint=0.0,
        box=np.asarray(info["box"]) if "box" in info else None,
        walls=np.ones(3) if paths.WALLS in static else None,  # the layout needs only to know that there are walls
        planes=nowhere if paths.PLANES in static else None,
    )
