"""An overview of a recording in rows of text, and its moments in words."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from carom.experiment.contact_counts import counts_text
from carom.experiment.ending import in_words
from carom.recording.read.recording import Recording

MOMENTS = {
    "impact": "hardest impact, {value:.4g} J of approach (½ μ v_n²)",
    "overlap": "deepest overlap, {value:.3%} of the smaller radius",
    "contacts": "most contacts, {value:.0f}",
    "energy_error": "largest integration error, {value:.2e} of the energy scale",
}


@dataclass(frozen=True, slots=True)
class Moment:
    """A time at which something was largest."""

    text: str  # the quantity, and the bodies
    step: int
    time: float  # s


def moments(summary: dict[str, Any]) -> list[Moment]:
    """Put the moments of a recording's summary into words."""
    found = []
    for name, wording in MOMENTS.items():
        moment = summary["moments"].get(name)
        if moment:
            who = f", {moment['between']}" if moment["between"] else ""
            found.append(Moment(wording.format(value=moment["value"]) + who, moment["step"], moment["time"]))
    return found


def overview(recording: Recording) -> list[tuple[str, str]]:
    """Return names and texts: command, outcome, length, energy, contacts, promises, versions, machine."""
    whole = recording.summary()
    energy, contacts = whole["energy"], whole["contacts"]
    counted = counts_text(contacts["total"], contacts.get("impacts"), contacts.get("impacts_counted"))
    return [
        ("command", str(recording.properties.get("command", ""))),
        ("outcome", in_words(whole["outcome"])),
        ("run", f"{whole['bodies']} bodies, {whole['steps']} steps, {whole['sim_time']:.6g} s simulated"),
        (
            "energy",
            f"{energy['initial']:.6g} J at first, {energy['final']:.6g} J at last; "
            f"integration error at most {energy['max_error']:.3g} of the scale",
        ),
        ("contacts", f"{counted}; deepest overlap {contacts['max_overlap']:.3g} of the smaller radius"),
        *((f"promise {name}", _promise(verdict)) for name, verdict in whole["expect"].items()),
        ("versions", ", ".join(f"{package} {version}" for package, version in recording.versions.items())),
        ("machine", f"{recording.properties.get('cpu', '')}, {recording.properties.get('platform', '')}"),
    ]


def _promise(verdict: dict[str, Any]) -> str:
    kept = "kept" if verdict["met"] else "MISSED"
    if not verdict.get("judged", True):
        kept = "not judged, the run ended elsewhere"
    return f"{verdict['measured']:.3g}, {verdict.get('bound', 'at most')} {verdict['limit']:.3g}: {kept}"
