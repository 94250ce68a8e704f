"""The summary of a recording, as `carom inspect` prints it and as a table in a notebook."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa

from carom.contact_table import ROUNDED_OVERLAP
from carom.errors import DamageError, RecordingError
from carom.recording.read.recorded_impacts import impacts_until
from carom.recording.read.recorded_scene import materials_of
from carom.recording.schema.header import NOTES
from carom.scene.units.dimension import ENERGY, TIME
from carom.scene.wording import body_called, counted, hypertext

if TYPE_CHECKING:
    from carom.recording.read.recorded_data import RecordedData


def summary(recording: RecordedData) -> dict[str, Any]:
    """Return nested numbers; docs/recording.md lists the keys.

    The largest errors of all steps come from the property `outcome`, under the same dotted keys; without this property,
    the largest errors of the recorded frames are used. The numbers of a clip describe its own frames; its outcome and
    expectations describe the whole run.
    """
    recording.refuse_overlay()
    frames = recording.fingerprints()
    clip, momenta = dict(recording.clip), recording.momentum()
    if clip:
        names = recording.bodies.name
        clip |= {"bodies": list(recording.shown), "names": [body_called(k, names[k]) for k in recording.shown]}
    found: dict[str, Any] = {
        "scene": {"title": recording.title, **({"engine": recording.engine} if recording.engine else {})},
        "units": recording.units.recorded,
        "bodies": int(recording.info["bodies"]),
        "frames": recording.frames,
        "first_step": int(frames["step"][0].as_py()) if recording.frames else 0,
        "begin": float(frames["time"][0].as_py()) if recording.frames else 0.0,
        "steps": int(frames["step"][-1].as_py()) if recording.frames else 0,
        "sim_time": float(frames["time"][-1].as_py()) if recording.frames else 0.0,
        "outcome": recording.outcome,
        "energy": _energy(recording.energy("total", "relative_error")) | _changes(recording),
        "momentum": {"max_error": _largest(momenta, "momentum_error")},
        "angular_momentum": {"max_error": _largest(momenta, "angular_momentum_error")},
        "contacts": _contacts(recording),
        "impacts": _impacts(recording),
        "warnings": [asdict(event) for event in recording.warnings()],
        "moments": _moments(recording),
        "profile": {} if clip else _below(recording.closing, "profile"),
        "accuracy": _below(recording.closing, "accuracy"),
        "versions": recording.versions,
        **_of_engine(recording),
        "expect": _complete(_below(recording.closing, "expect"), ("measured", "limit", "met")),
    }
    if materials := materials_of(recording):
        found["materials"] = materials.described
    indices = sorted(int(key.partition(".")[2]) for key in recording.info if NOTES.fullmatch(key))
    if notes := [note for index in indices for note in recording.data_notes(index)]:
        found["data_notes"] = notes
    if clip:
        first, last = found["first_step"], found["steps"]
        shown = set(recording.shown)
        inside = {
            name: moment
            for name, moment in found["moments"].items()
            if first <= moment["step"] <= last and shown.issuperset(moment["bodies"])
        }
        return found | {"clip": clip | {"first_step": first}, "moments": inside}
    for section in ("energy", "momentum", "angular_momentum", "contacts"):
        found[section] |= _below(recording.closing, section)
    if "contacts.total" in recording.closing:
        found["contacts"]["summed_over"] = "steps"
    return found


def _of_engine(recording: RecordedData) -> dict[str, Any]:
    """Describe another engine's run: its judged bodies, and the violated laws with their first frames."""
    if not recording.engine:
        return {}
    judged = recording.closing.get("audit.judged", recording.info["bodies"])
    lives = {}
    if recording.lives is not None:
        first, last = recording.lives.T
        ends = recording.fingerprints()["step"].to_numpy()[[0, -1]] if recording.frames else (0, 0)
        came, went = np.count_nonzero(first > ends[0]), np.count_nonzero((first >= 0) & (last < ends[1]))
        lives = {"lives": {"came": int(came), "went": int(went)}}
    return {
        **lives,
        "contact_forces": recording.records_contacts,
        "judged": int(judged),
        "parted": float(recording.closing.get("audit.parted", 0.0)),
        "forces": {} if recording.clip else _forces(recording),
        "laws": _laws(recording),
    }


def _forces(recording: RecordedData) -> dict[str, Any]:
    """Describe the forces that the audit accounts for: known work (J), and a common damping (1/s, 1/m or 1/rad)."""
    found = _below(recording.closing, "audit")
    dampings: dict[str, Any] = {name: found[name] for name in ("damping", "angular_damping") if name in found}
    return {"work": float(found.get("forced", 0.0)), **dampings}


def _laws(recording: RecordedData) -> dict[str, dict[str, Any]]:
    """Describe the violated laws in the order of their first steps, since later ones may be consequences.

    Of laws first broken in one step, the one with the largest ratio of violation to tolerance comes first. Overlaps
    come last: they are the accuracy of an engine unless `Tolerances.overlap` is set.
    """
    keys = ("step", "time", "frames", "text", "excess", "bodies")
    laws = _complete(_below(recording.closing, "laws"), keys)
    for law in laws.values():
        law["bodies"] = [int(end) for end in str(law["bodies"]).split(",") if end]

    def rank(row: tuple[str, dict[str, Any]]) -> tuple[bool, int, float]:
        name, law = row
        return name == "overlap", law["step"], -law["excess"]

    return dict(sorted(laws.items(), key=rank))


def _impacts(recording: RecordedData) -> dict[str, int]:
    """Count recorded and unrecorded impacts; empty if impacts are not recorded, as in runs of other engines."""
    if recording.engine or not recording.records_contacts or not recording.frames:
        return {}
    last = int(recording.fingerprints()["step"][-1].as_py())
    return asdict(impacts_until(recording, last))


def _energy(energy: pa.Table) -> dict[str, float]:
    """Return the first and the last energy and the largest error; NaN if no frame has them."""
    if energy.num_rows == 0:
        return dict.fromkeys(("initial", "final", "max_error"), float("nan"))
    total = energy["total"].to_numpy()
    worst = float(np.max(np.abs(energy["relative_error"].to_numpy())))
    return {"initial": float(total[0]), "final": float(total[-1]), "max_error": worst}


def _changes(recording: RecordedData) -> dict[str, float]:
    """Split the energy change (J) of another engine's run into changes with and without touching bodies.

    While bodies touch, both the work of contacts and errors of the engine change the energy; the states cannot
    distinguish these.
    """
    if not recording.engine:
        return {}
    energy = recording.energy()
    if energy.num_rows == 0:
        return dict.fromkeys(("change_in_contact", "change_without_contact"), float("nan"))
    lost, other = (
        energy[name].to_numpy() if name in energy.column_names else np.zeros(1)
        for name in ("restitution", "integration_error")
    )
    return {"change_in_contact": float(lost[0] - lost[-1]), "change_without_contact": float(other[-1] - other[0])}


def _largest(momenta: pa.Table, name: str) -> float | None:
    """Return the largest error of the recorded frames; None if the error is not defined, NaN if no frame has it."""
    if momenta.num_rows == 0:
        return float("nan")
    errors = np.concatenate([np.zeros(1), *(np.ravel(value) for value in momenta[name].to_numpy())])
    worst = float(np.max(errors))
    return None if np.isnan(worst) else worst


def _contacts(recording: RecordedData) -> dict[str, Any]:
    """Return the sum of contacts in the recorded frames and the deepest overlap; None for a lost value."""
    steps = recording.steps("contacts")
    if "contacts" not in steps.column_names or steps.num_rows == 0:
        return {"total": 0, "max_overlap": 0.0, "summed_over": "frames"}
    try:
        deepest = float(np.max(recording.steps("relative_overlap")["relative_overlap"].to_numpy()))
    except RecordingError:
        deepest = None
    total = int(np.sum(steps["contacts"].to_numpy()))
    return {"total": total, "max_overlap": deepest, "summed_over": "frames"}


def _moments(recording: RecordedData) -> dict[str, Any]:
    """Return the moments of the extremes as nested entries.

    Bodies are written as ``3,17``, since a property cannot hold a list of unknown length.
    """
    moments = _complete(_below(recording.closing, "moments"), ("value", "step", "time"))
    for moment in moments.values():
        moment |= {name: _numbers(moment.get(name, "")) for name in ("bodies", "planes")}
        moment.setdefault("between", "")
    return moments


def _numbers(text: Any) -> list[int]:
    return [int(number) for number in str(text).split(",") if number]


def _complete(entries: dict[str, Any], keys: tuple[str, ...]) -> dict[str, Any]:
    """Refuse incomplete entries."""
    for name, entry in entries.items():
        if missing := [key for key in keys if not isinstance(entry, dict) or key not in entry]:
            raise DamageError(f"its property outcome has {name} without {missing[0]}")
    return entries


def _below(properties: Mapping[str, Any], section: str) -> dict[str, Any]:
    """Nest the entries whose dotted keys begin with a section."""
    found: dict[str, Any] = {}
    for key, value in properties.items():
        top, *path = key.split(".")
        if top == section and path:
            inner = found
            for name in path[:-1]:
                inner = inner.setdefault(name, {})
            inner[path[-1]] = value
    return found


def html_of(recording: RecordedData) -> str:
    """Return the summary of a recording as an HTML table, or the error if it cannot be read."""
    try:
        summary = recording.summary()
        energy, overlap = summary["energy"], summary["contacts"]["max_overlap"]
        counts = counted(summary["frames"], "frame"), counted(summary["steps"], "step")
        rows = {
            "scene": f"{summary['scene']['title']}, {counted(summary['bodies'], 'body')}",
            "outcome": str(summary["outcome"]),
            "length": ", ".join((*counts, recording.units.text(summary["sim_time"], TIME))),
        }
        if not math.isnan(energy["initial"]):
            first, last = (recording.units.text(energy[when], ENERGY) for when in ("initial", "final"))
            rows["energy"] = f"{first} at first, {last} at last"
            rows["energy error"] = f"{_number(energy['max_error'])} of the energy scale"
        if overlap is None or overlap > ROUNDED_OVERLAP:
            rows["deepest overlap"] = f"{_number(overlap)} of a radius"
    except RecordingError as error:
        return f"<p>{hypertext(str(error))}</p>"
    cells = "".join(f"<tr><th>{hypertext(name)}</th><td>{hypertext(text)}</td></tr>" for name, text in rows.items())
    return f"<table><caption>{hypertext(recording.path.name)}</caption>{cells}</table>"


def _number(value: float | None) -> str:
    return "not recorded" if value is None else f"{value:.6g}"
