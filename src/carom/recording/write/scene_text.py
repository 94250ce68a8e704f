"""The text at /scene, in Markdown: the run, the scales and the colours."""

from __future__ import annotations

import numpy as np

from carom.recording.schema import palette
from carom.recording.schema.clock import Clock
from carom.recording.schema.header import Header
from carom.recording.schema.paths import ANGULAR_ACCELERATION, FORCE_NORMAL, TORQUE
from carom.recording.style.arrow_length import arrow_length
from carom.recording.style.body_shape import shape
from carom.scene.units.dimension import LENGTH, MASS, TIME
from carom.scene.wording import in_series


def scene_document(header: Header, clock: Clock, origin: np.ndarray[tuple[int], np.dtype[np.float64]]) -> str:
    """Return the document."""
    parts = [f"# {header.title}", header.description.strip(), _run(header), _data(header)]
    parts.append(_scales(header, clock, origin))
    return "\n\n".join(part for part in [*parts, _legend(header), _contacts(header)] if part) + "\n"


def _run(header: Header) -> str:
    radius, units = header.radius, header.units
    lines = [
        "| | |",
        "|---|---|",
        f"| bodies | {header.bodies} |",
        f"| radii | {units.shown(radius.min(), LENGTH):.4g} to {units.text(radius.max(), LENGTH, '.4g')} |",
        f"| total mass | {units.text(header.mass.sum(), MASS)} |",
    ]
    if massless := int(np.count_nonzero(header.mass == 0.0)):
        lines.append(f"| test particles | {massless} |")
    if not header.engine:
        lines += [f"| duration asked for | {units.text(header.duration, TIME, 'g')} |", f"| seed | {header.seed} |"]
    return "\n".join(lines + [f"| {name} | {value} |" for name, value in header.properties.items()])


def _data(header: Header) -> str:
    """List what of data files is not used, or read in another way; empty if all is."""
    notes = [note.replace("`", "'") for notes in header.data_notes for note in notes]
    return "\n".join(["## Data", *(f"- `{note}`" for note in notes)]) if notes else ""


def _scales(header: Header, clock: Clock, origin: np.ndarray[tuple[int], np.dtype[np.float64]]) -> str:
    x, y, z = origin
    m, torque, turning = (_drawn(header, unit) for unit in ("m", "N m", "rad/s²"))
    lines = ["## Scales", *_units(header)]
    lines.append(f"{_lengths(header)} from the centre of mass of the first frame at ({x:g}, {y:g}, {z:g}){m}.")
    if clock.scale != 1.0 or header.units.own:
        scaled = "**Time is scaled**: one" if clock.scale != 1.0 else "One"
        stands_for = f"{clock.scale:g}{_drawn(header, 's')} of the simulation"
        lines.append(f"- {scaled} second on `sim_time` stands for {stands_for}.")
    if header.has_torque:
        lines.append(
            "- Arrows start at a body's centre. What sticks out of the sphere is L = L_max · s / (1 + s) long, with "
            f"s = (m / m_ref)^⅓. L_max is {arrow_length(header, TORQUE):.4g}{m} for torques and "
            f"{arrow_length(header, ANGULAR_ACCELERATION):.4g}{m} for angular accelerations; m_ref "
            f"({', '.join(unit.strip() for unit in (torque, turning) if unit)}) stands "
            "in the recording's property `arrows`."
        )
    if header.planes is not None:
        names = in_series(header.planes.name)
        lines.append(f"- Static planes, drawn as grids: {names}. They extend without end.")
    if header.walls is not None:
        lines.append("- Walls with sides " + " × ".join(f"{side:g}" for side in header.walls) + f"{m}.")
    if header.box is not None:
        lines.append("- The box is periodic with sides " + " × ".join(f"{side:g}" for side in header.box) + f"{m}.")
    return "\n".join(lines)


def _drawn(header: Header, si: str) -> str:
    """Return the unit of recorded numbers, after a space, by its name in SI; empty if they have none."""
    unit = header.units.recorded_unit(si)
    return "" if unit == "1" else f" {unit}"


def _units(header: Header) -> list[str]:
    """Say which units the scene has, if it is not SI."""
    units = header.units
    if units.is_si:
        return []
    if units.own:
        return ["- The numbers have no units." if units.dimensionless else f"- Numbers are in {units.named}."]
    return [f"- The recording is in SI. The scene is written in {units.named}."]


def _lengths(header: Header) -> str:
    return "- Positions are" if header.units.own else "- Lengths are metres,"


def _legend(header: Header) -> str:
    lines = ["## Colours", f"- Bodies: {_body_colours(header)}."]
    if header.collides and header.engine:
        lines.append("- Lines join the centres of touching bodies.")
    elif header.collides:
        stages = ", ".join(f"{k} {name}" for k, name in enumerate(palette.STAGE_NAMES))
        lines.append(
            f"- Lines join the centres of touching bodies. Their colour is the stage in which the contact is resolved: "
            f"{stages}, then again from the start; white is the last, serial stage (past {palette.SERIAL_STAGE})."
        )
    if header.records_contacts:
        lines += _impulse_legend(header)
    if header.has_torque:
        lines.append("- Arrows: torque orange and thick, angular acceleration green and thin.")
    if shape(header) == "mesh":
        lines.append("- Dark and light halves of a sphere show how it turns.")
    return "\n".join(lines)


def _contacts(header: Header) -> str:
    """Give the coefficients of the contacts of each two materials; empty without [[material]]."""
    if header.materials is None or not header.collides:
        return ""
    lines = ["## Contacts", "| | e | μs | μk |", "|---|---|---|---|"]
    for kind in header.materials.contacts:
        values = " | ".join(f"{value:.4g}" for value in kind.coefficients)
        lines.append(f"| {kind} | {values} |")
    return "\n".join(lines)


def _impulse_legend(header: Header) -> list[str]:
    """Explain how impulses and impacts are drawn."""
    longest, m, joules = arrow_length(header, FORCE_NORMAL), _drawn(header, "m"), _drawn(header, "J")
    friction = ", and the friction on it (green)" if header.has_friction else ""
    return [
        "- In the view of impulses the same lines are wide and bright by the normal impulse J of the step: "
        "u = s / (1 + s), s = (J / m_ref)^⅓, from dark purple (u = 0) over red (⅓) and orange (⅔) to pale yellow (1). "
        "Chains of wide lines carry the load. m_ref is the median of the frame.",
        "- The contacts of the largest impulses have arrows at the contact point: the normal impulse on the second "
        f"body (sky blue){friction}, {longest:.4g}{m} · u long.",
        "- Points are impacts, each where the two touched: as large as the impulse (m_ref is `impacts` in the "
        "property `arrows`), as bright as "
        f"the energy lost (m_ref{' in' if joules else ''}{joules} is `impacts.energy`). On the timeline `impact` one "
        "steps from each to the next.",
    ]


def _body_colours(header: Header) -> str:
    if shape(header) == "mesh":
        return "one colour for all of them, since there are so many"
    match header.coloured_by:
        case "material" if header.materials:
            pairs = zip(header.materials.names, header.materials.colours, strict=True)
            return "by material, " + ", ".join(f"{name} {palette.name_of(colour)}" for name, colour in pairs)
        case "graph":
            return "the body's colour in the collision graph, or grey without contacts"
        case "island":
            return "one colour for bodies that are connected by contacts, or grey without contacts"
        case "speed":
            return "by speed, from violet to yellow; the colour in the middle is the median speed of the first frame"
    return "a hue for each group and each single body, in turns, and a shade for each body"
