"""A recording in a notebook: its summary as a table."""

from __future__ import annotations

import math
from html import escape
from typing import TYPE_CHECKING, Any

from carom.errors import RecordingError
from carom.physics.diagnostics.extremes import ROUNDED_OVERLAP
from carom.scene.units.dimension import ENERGY, TIME
from carom.scene.units.system import UnitSystem
from carom.scene.wording import counted

if TYPE_CHECKING:
    from carom.recording.read.recording import Recording


def html_of(recording: Recording) -> str:
    """Return the summary of a recording as an HTML table; of a file that cannot be read, why."""
    try:
        rows = _rows(recording.summary(), recording.units)
    except RecordingError as error:
        return f"<p>{escape(str(error))}</p>"
    cells = "".join(f"<tr><th>{escape(name)}</th><td>{escape(text)}</td></tr>" for name, text in rows.items())
    return f"<table><caption>{escape(recording.path.name)}</caption>{cells}</table>"


def _rows(summary: dict[str, Any], units: UnitSystem) -> dict[str, str]:
    energy, overlap = summary["energy"], summary["contacts"]["max_overlap"]
    counts = counted(summary["frames"], "frame"), counted(summary["steps"], "step")
    rows = {
        "scene": f"{summary['scene']['title']}, {counted(summary['bodies'], 'body')}",
        "outcome": str(summary["outcome"]),
        "length": ", ".join((*counts, units.text(summary["sim_time"], TIME))),
    }
    if not math.isnan(energy["initial"]):
        first, last = (units.text(energy[when], ENERGY) for when in ("initial", "final"))
        rows["energy"] = f"{first} at first, {last} at last"
        rows["energy error"] = f"{_number(energy['max_error'])} of the energy scale"
    if overlap is None or overlap > ROUNDED_OVERLAP:
        rows["deepest overlap"] = f"{_number(overlap)} of a radius"
    return rows


def _number(value: float | None) -> str:
    return "not recorded" if value is None else f"{value:.6g}"
