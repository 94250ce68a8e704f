"""A scene that begins with an exact state from a recording, made by carom or by another engine."""

from __future__ import annotations

from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from carom.arrays import FloatArray
from carom.contact_table import MODES, SLIDING
from carom.engines.measured_contacts import measured_impacts, setup_of, smallest_gap
from carom.engines.source import Setup
from carom.errors import RecordingError
from carom.lab.shrink.literal import BODIES, BodyStates, Document, at_moment, bodies_of, literal
from carom.lab.shrink.shrunk_file import commented
from carom.recording.read.lookup import goal_of
from carom.recording.read.recorded_scene import recorded_scene, start_of
from carom.recording.read.recording import Recording
from carom.runs.window import Window, checkpoint_before
from carom.scene.start import InitialBodies
from carom.scene.units.dimension import TIME
from carom.scene.wording import counted

SURE = 0.1  # largest uncertainty of a coefficient that is used although others are more certain
# Largest uncertainty, as a share of μ, of a slide that shows μ. A contact that stuck, and slips only by the next
# contact of its cluster, seems to slide, with less than μ: 0.14 ± 0.035 and 0.11 ± 0.11 where μ is 0.3. Slides of
# bodies in free flight have 0.12 at impacts of 0.6 m/s in steps of 1/240 s.
SURE_SLIDE = 0.2
DIGITS = 3  # digits of a measured coefficient; further digits are uncertain
LEAST_STEPS = 100  # smallest number of engine steps in a scene if the recording ends soon after the frame


def scene_of_frame(recording: Recording, at: float | None, command: str) -> str:
    """Return the text of a scene that begins with the recorded state at the end of the step that contains a time (s).

    The default time is the frame before the first broken law, or the first frame. For another engine, the coefficients
    are measured from its impacts.

    Raises
    ------
    RecordingError, SceneError
        If the recording lacks this state, or its scene has walls that move.
    """
    recording.refuse_overlay()
    recording.refuse_some_bodies()
    moment = _before_the_first_law(recording) if at is None else recording.moment(at)
    document, comments = _of_engine(recording, moment) if recording.engine else _of_carom(recording, moment)
    return commented(document, [command, *comments])


def _before_the_first_law(recording: Recording) -> float:
    """Return the time (s) of the frame before the first broken law, or of the first frame if no law is broken."""
    recording.require_frames()
    frames, laws = recording.fingerprints(), recording.summary().get("laws", {})
    first = next(iter(laws.values()), None)
    row = 0 if first is None else int(np.searchsorted(frames["step"].to_numpy(), first["step"])) - 1
    return float(frames["time"][max(row, 0)].as_py())


def _of_carom(recording: Recording, moment: float) -> tuple[Document, list[str]]:
    scene = recorded_scene(recording)
    motions = *(plane.motion or plane.piston for plane in scene.plane), *(wall.motion for wall in scene.wall)
    if any(motion is not None for motion in motions):
        raise RecordingError(
            f"{recording.path}: moving walls would start again from their initial positions; use carom fork"
        )
    goal = goal_of(recording, moment)
    frame = next(each for each in Window(recording, goal).frames(goal) if each.time >= goal)
    left = max(scene.time.duration - frame.time, LEAST_STEPS * frame.dt)
    document = literal(scene, start_of(recording, scene, checkpoint_before(recording, moment)))
    when = recording.units.text(frame.time, TIME, ".9g")
    said = f"The state of step {frame.step}, t = {when}. Contacts at rest begin without their impulses."
    return at_moment(document, BodyStates.of(frame), left), [said]


def _of_engine(recording: Recording, moment: float) -> tuple[Document, list[str]]:
    frames, units = recording.fingerprints(), recording.units
    row = min(int(np.searchsorted(frames["time"].to_numpy(), goal_of(recording, moment))), frames.num_rows - 1)
    step, time = (frames[name][row].as_py() for name in ("step", "time"))
    if step not in recording.checkpoint_times:
        raise RecordingError(f"{recording.path} has no exact state of step {step}; record with exact=True")
    (state,) = recording.checkpoints([step])
    setup, there = setup_of(recording), np.isfinite(state.position).all(axis=1)
    spin = np.zeros_like(state.position) if state.angular_velocity is None else state.angular_velocity
    start = InitialBodies(
        name=[setup.names[k] for k in np.flatnonzero(there)],
        group=np.zeros(int(there.sum()), np.int64),
        position=state.position[there],
        velocity=np.where(setup.fixed[:, None], 0.0, state.velocity)[there],
        angular_velocity=np.where(setup.fixed[:, None], 0.0, spin)[there],
        mass=setup.mass[there],
        radius=setup.radius[there],
        inertia=setup.inertia[there],
        fixed=setup.fixed[there],
    )
    times = frames["time"].to_numpy()
    shortest = float(np.diff(times).min()) if len(times) > 1 else 0.0
    document: Document = {"title": f"Step {step} of {recording.path.name}, recorded from {recording.engine}"}
    if units.own and units.named:
        document["units"] = units.named
    document["time"] = {"duration": max(float(times[-1]) - time, LEAST_STEPS * shortest) or 1.0}
    document["gravity"] = {"constant": setup.constant}
    if setup.gravity.any():
        document["gravity"]["uniform"] = setup.gravity.tolist()
    if setup.softening:
        document["gravity"]["softening"] = setup.softening
    if setup.box[0] > 0.0:
        document["domain"] = {"boundary": "periodic", "size": setup.box.tolist()}
    comments = [f"The exact state of step {step}, t = {units.text(time, TIME, '.9g')}, of {recording.engine}."]
    between, planes, said = _coefficients(recording, setup)
    document["contact"] = between if setup.collides else {"enabled": False}
    if setup.collides and smallest_gap(recording, state) < 0.0:
        document["contact"] |= {"allow_overlap": True, "timing": "end-of-step"}
    solid = zip(setup.planes.name, setup.planes.normal, setup.planes.offset, strict=True)
    if len(setup.planes):
        document["plane"] = [
            {"name": name, "point": (offset * normal).tolist(), "normal": normal.tolist(), **planes[k]}
            for k, (name, normal, offset) in enumerate(solid)
        ]
    if not setup.judged.all():
        count = int(np.count_nonzero(~setup.judged))
        comments.append(f"{counted(count, 'body')} of the engine had other shapes or joints, and is a sphere here.")
    document[BODIES] = bodies_of(start)
    return document, [*comments, *said]


def _coefficients(recording: Recording, setup: Setup) -> tuple[dict[str, Any], list[dict[str, Any]], list[str]]:
    """Return the measured coefficients between bodies and with each plane, and comments on them."""
    table = measured_impacts(recording) if setup.collides else None
    found, said, n = list[dict[str, Any]](), list[str](), len(setup)
    for plane in (None, *range(len(setup.planes))):
        what = "bodies" if plane is None else setup.planes.name[plane]
        rows = None if table is None else table.filter(_between(table, n, plane))
        keys = {} if rows is None else _measured(rows)
        found.append(keys)
        if keys and rows is not None:
            shown = ", ".join(f"{name} {value:g}" for name, value in keys.items())
            text = f"Coefficients of {what}, measured in {counted(rows.num_rows, 'impact')}: {shown}."
            if "kinetic_friction" in keys and not _slides(rows).num_rows:
                text += " Friction is a lower bound, since no impact surely slid to its end."
            said.append(text)
        elif rows is not None:
            said.append(f"Coefficients of {what} are carom's defaults: the recording has no impact that shows them.")
    return found[0], found[1:], said


def _between(table: pa.Table, n: int, plane: int | None) -> pa.Array:
    return pc.less(table["j"], n) if plane is None else pc.equal(table["j"], n + plane)


def _measured(rows: pa.Table) -> dict[str, float]:
    """Return the coefficients of a scene from impacts; without a sliding impact, friction is a lower bound."""
    keys = dict[str, float]()
    values = _sure(rows, "restitution")
    if len(values):
        keys["restitution"] = float(np.clip(np.median(values), 0.0, 1.0))
    values = _slides(rows)["friction"].to_numpy()
    if not len(values):
        bounds, errors = _values(rows, "friction")
        values = (bounds - errors)[np.isfinite(bounds)]
        values = values[np.argmax(values, keepdims=True)] if len(values) else values
    if len(values):
        keys["static_friction"] = keys["kinetic_friction"] = max(float(np.median(values)), 0.0)
    return {name: float(f"{value:.{DIGITS}g}") for name, value in keys.items()}


def _slides(rows: pa.Table) -> pa.Table:
    """Return the impacts that slid, and whose friction is certain."""
    rows = rows.filter(pc.equal(rows["mode"], MODES[SLIDING]))
    values, errors = _values(rows, "friction")
    return rows.filter(errors <= SURE_SLIDE * values)


def _sure(rows: pa.Table, name: str) -> FloatArray:
    """Return the measured values with small uncertainties; all values if every uncertainty is large."""
    values, errors = _values(rows, name)
    known = np.isfinite(values)
    sure = known & (errors <= SURE)
    return np.asarray(values[sure if sure.any() else known])


def _values(rows: pa.Table, name: str) -> tuple[FloatArray, FloatArray]:
    """Return a measured coefficient and its uncertainty."""
    return rows[name].to_numpy(), rows[f"{name}_error"].to_numpy()
