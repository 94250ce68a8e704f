"""The closing properties of a recording that come from the extremes of its run."""

from __future__ import annotations

from carom.physics.diagnostics.extremes import Extreme, Extremes
from carom.recording.schema.header import Scalar


def closing_of(extremes: Extremes) -> dict[str, Scalar]:
    """Return the extremes of a run, with bodies and planes by their names, under the dotted keys of `outcome`."""
    summary: dict[str, Scalar] = {
        "contacts.total": extremes.total_contacts,
        "contacts.impacts": extremes.impacts,
    }
    if extremes.momentum_error is not None:
        summary["momentum.max_error"] = extremes.momentum_error.value
    if extremes.angular_momentum_error is not None:
        summary["angular_momentum.max_error"] = extremes.angular_momentum_error.value
    if extremes.energy_error is not None:
        summary["energy.max_error"] = extremes.energy_error.value
    summary["energy.reference"] = extremes.energy_scale  # J; the viewer loads no recording with "energy.scale" here
    summary["energy.contact_gain"] = extremes.contact_gain.value
    if extremes.overlap is not None:
        summary["contacts.max_overlap"] = extremes.overlap.value
    for name in ("energy_error", "impact", "overlap", "contacts"):
        moment: Extreme | None = getattr(extremes, name)
        if moment is not None:
            key = f"moments.{name}"
            summary |= {f"{key}.value": moment.value, f"{key}.step": moment.step, f"{key}.time": moment.time}
            summary[f"{key}.bodies"] = ",".join(map(str, moment.bodies))
            summary[f"{key}.planes"] = ",".join(map(str, moment.planes))
            summary[f"{key}.between"] = moment.between
    return summary
