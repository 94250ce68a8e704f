"""The texts of a recording: /about for readers without carom, /legend, and /scene."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from carom.arrays import FloatArray
from carom.recording.layout import force_arrows, is_crowded, turning_arrows
from carom.recording.layout.drawing import arrow_length, shape
from carom.recording.schema import palette, paths
from carom.recording.schema.header import Header, TimeScale
from carom.recording.schema.paths import FORCE_NORMAL
from carom.recording.schema.series import recorded
from carom.scene.portable_math import ENDLESS
from carom.scene.units.dimension import LENGTH, MASS, RATE, TIME
from carom.scene.wording import in_series, literal

# how centres are stored, by the shape of drawn bodies
_CENTRES = dict(zip(("ellipsoids", "points", "mesh"), paths.CENTRES, strict=True))
_ARROWS = {  # by entity: what its arrows show, and the unit of the arrows' magnitudes
    paths.TORQUE: ("torques of contacts that last", "N m"),
    paths.ANGULAR_ACCELERATION: ("angular accelerations by these torques", "rad/s²"),
    paths.ANGULAR_IMPULSE: ("angular impulses of impacts", "N m s"),
    paths.SPIN_CHANGE: ("changes of spin by these impacts", "rad/s"),
    paths.FORCE_NORMAL: ("normal impulses on the second body, or on a body out of a plane or wall", "N s"),
    paths.FORCE_FRICTION: ("impulses of friction on the same body", "N s"),
}
_READ = """```python
from rerun.chunk import RrdReader

store = RrdReader("FILE.rrd").store()
for chunk in store.stream().filter(content="/energy/total", is_static=False):
    print(chunk.to_record_batch().to_pydict())  # columns: step, sim_time, Scalars:scalars
```"""


def about_document(header: Header, clock: TimeScale) -> str:
    """Return the text at /about, in Markdown: it describes the file, and how to read it without carom."""
    version = str(header.properties.get("version.carom", ""))
    carom = f"carom {literal(version)}".rstrip()
    source = f"It was recorded from {literal(header.engine)}." if header.engine else "carom computed it."
    replayed = "." if header.engine else ", and `carom replay`, which repeats the run with the same bits."
    parts = [
        f"# {literal(header.title)}\n",
        f"This file is a recording by {carom}, a flight recorder for colliding spheres. It has {header.bodies} rigid "
        f"{'sphere' if header.bodies == 1 else 'spheres'}, with their contacts, impacts and energies. {source}\n",
        "## Look at it\n",
        "- In Rerun alone: `rerun FILE.rrd`. Click a line of Events to go to its time. Rerun's "
        "layouts cannot place the cursor of time, so the file opens at its beginning.",
        "- With carom: `pip install .` in a copy of its repository, then `carom view FILE.rrd`, which pauses at the "
        f"most telling moment and draws a close-up, `carom inspect`, `carom contacts`, `carom export`{replayed}",
        "- /legend explains arrows, colours and lines; /scene describes the run.\n",
        "## Timelines\n",
        "| | |",
        "|---|---|",
        *_timelines(header, clock),
        "\n## Entities\n",
        "Sizes, colours and texts are static. Positions and vectors of arrows are float32; energies are float64.\n",
        "| entity | what | components and units |",
        "|---|---|---|",
        *(f"| `/{path}` | {what} | {unit} |" for path, what, unit in _entities(header)),
        "\n## Read it\n",
        "An entity of the table replaces `/energy/total`, and a component its column:\n",
        _READ,
    ]
    return "\n".join(parts) + "\n"


def _timelines(header: Header, clock: TimeScale) -> Iterator[str]:
    stands_for = header.units.text(clock.scale, TIME, "g")
    yield "| `step` | number of the step that ends at a frame |"
    yield f"| `sim_time` | time; one second stands for {stands_for} of the simulation |"
    if header.records_contacts:
        yield "| `impact` | number of an impact, from 1 on; the states between two frames at which bodies meet |"


def _entities(header: Header) -> Iterator[tuple[str, str, str]]:
    """Yield each entity, its description, and its components with their units."""

    def unit(si: str) -> str:
        return header.units.recorded_unit(si)

    length = unit("m")
    turned = ", quaternions (x, y, z, w)" if header.has_orientation else ""
    spheres = "the spheres; NaN while one waits to enter, or has left" if header.admits else "the spheres"
    yield paths.BODIES, spheres, f"`{_CENTRES[shape(header)]}` ({length}, from the origin in /scene){turned}"
    if header.collides:
        numbers = f"; `bodies`, `normal_impulse`, `tangential_impulse` ({unit('N s')}), `mode` (0 impact, 1 sticking, "
        numbers = numbers + "2 sliding, 3 resting, 4 open)" if header.records_contacts else ""
        yield paths.CONTACTS, "the collision graph: lines between bodies that touch", f"`LineStrips3D:strips`{numbers}"
    for path in (*turning_arrows(header), *force_arrows(header)):
        what, si = _ARROWS[path]
        whose = "body" if path in turning_arrows(header) else "bodies"
        magnitude = f"`{paths.MAGNITUDES[path]}` ({unit(si)})"
        yield path, what, f"{magnitude}, `{whose}`; `Arrows3D:vectors` ({length}, by the cube root: /legend)"
    if header.records_contacts and not header.engine:
        sizes = f"`approach_speed` ({unit('m/s')}), `normal_impulse`, `tangential_impulse` ({unit('N s')})"
        yield paths.IMPACTS, "impacts, one in each row", f"`bodies`, {sizes}, `energy_lost` ({unit('J')})"
        if header.spins:
            yield paths.IMPACT_SPINS, "spins at an impact", f"`bodies`, `before`, `after` ({unit('rad/s')})"
    for series in recorded(header):
        yield series.path, series.meaning, f"`Scalars:scalars` ({unit(series.unit)})"
    yield paths.PHASE, "phase of the run", "`StateChange:state`"
    yield paths.DT_LIMIT, "what limits the step", "`StateChange:state`"
    yield paths.EVENTS, "log", "`TextLog:text`, `kind`"
    momenta = f"`momentum` ({unit('kg m/s')}), `angular_momentum` ({unit('kg m²/s')})"
    yield paths.MOMENTUM, "momenta about the origin", momenta
    yield paths.FINGERPRINT, "a hash of the exact state", "`fingerprint`, `time`"
    yield paths.CHECKPOINT, "exact states in float64, at some frames", "`position`, `velocity`, …: docs/recording.md"
    yield paths.STATIC_STATE, "names, masses, radii, moments of inertia", f"`mass` ({unit('kg')}), `radius` ({length})"
    yield paths.SCENE_TOML, "the scene, exactly", "`TextDocument:text`"
    for path, there in (
        (paths.PLANES, header.planes is not None),
        (paths.WALLS, header.walls is not None),
        (paths.SHAPES, bool(header.shapes)),
        (paths.PERIODIC_BOX, header.box is not None),
        (paths.MOVING, header.drives),
        (paths.GIVEN_STATE, bool(header.data)),
    ):
        if there:
            yield path, _SURROUNDINGS[path], ""


_SURROUNDINGS = {
    paths.PLANES: "planes, as grids",
    paths.WALLS: "walls of the domain",
    paths.SHAPES: "walls of other shapes",
    paths.PERIODIC_BOX: "the periodic box",
    paths.MOVING: "each plane and wall, which may move",
    paths.GIVEN_STATE: "the bodies of the scene's data files",
}


def legend_document(header: Header) -> str:
    """Return the text at /legend, in Markdown: the meaning of colours, lines and arrows, and the lengths of arrows."""
    head = [
        f"# Legend: {literal(header.title)}",
        "Press play at the lower left, or drag in the bar of time beside it.\n",
    ]
    return "\n".join([*head, *_legend(header), *_lengths(header)]) + "\n"


def _lengths(header: Header) -> Iterator[str]:
    """State the lengths of arrows."""
    if not header.has_torque:
        return
    short, long = (header.units.text(arrow_length(header, path), LENGTH, ".4g") for path in paths.OF_LASTING)
    yield (
        "- Arrows start at a body's centre. What sticks out of the sphere is L = L_max · s / (1 + s) long, with "
        f"s = (m / m_ref)^(1/3). L_max is {short} for torques and angular impulses, {long} for angular accelerations "
        "and changes of spin; m_ref stands in the recording's property `arrows`, and the magnitude m beside each arrow."
    )


def scene_document(header: Header, clock: TimeScale, origin: FloatArray) -> str:
    """Return the text at /scene, in Markdown: the run and the scales."""
    about = "\n".join(literal(line) for line in header.description.strip().splitlines())
    parts = [f"# {literal(header.title)}", about, _run(header), _data(header)]
    parts += [_scales(header, clock, origin), _contacts(header)]
    return "\n\n".join(part for part in parts if part) + "\n"


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
    return "\n".join(
        lines
        + [
            f"| {literal(name)} | {literal(str(value))} |"
            for name, value in sorted(header.properties.items())
            if value != ""
        ]
    )


def _data(header: Header) -> str:
    """List the notes on data files (unused or reinterpreted columns); empty if there are none."""
    notes = [literal(note) for notes in header.data_notes for note in notes]
    return "\n".join(["## Data", *(f"- {note}" for note in notes)]) if notes else ""


def _scales(header: Header, clock: TimeScale, origin: FloatArray) -> str:
    units = header.units
    x, y, z = (units.shown(each, LENGTH) for each in origin.tolist())
    lines = ["## Scales"]
    if units.own:
        lines.append("- The numbers have no units." if units.dimensionless else f"- Numbers are in {units.named}.")
    elif not units.is_si:
        own = f"- Plots, legends and texts are in the units of the scene, {units.named}; the recorded data are in SI."
        lines.append(own)
    at = f"({x:g}, {y:g}, {z:g}) {units.unit(LENGTH)}".rstrip()
    lengths = "Positions are" if units.own else "Lengths are metres,"
    lines.append(f"- {lengths} from the centre of mass of the first frame at {at}.")
    if clock.scale != 1.0 or header.units.own:
        scaled = "**Time is scaled**: one" if clock.scale != 1.0 else "One"
        stands_for = f"{units.text(clock.scale, TIME, 'g')} of the simulation"
        lines.append(f"- {scaled} second on `sim_time` stands for {stands_for}.")
    if header.planes is not None:
        names = literal(in_series(header.planes.name))
        lines.append(f"- Static planes, drawn as grids: {names}. They extend to infinity.")
    if header.shapes:
        names = literal(in_series([wall.name or wall.shape for wall in header.shapes]))
        lines.append(f"- Walls, drawn as translucent surfaces: {names}. Some extend beyond what is drawn.")
    if header.walls is not None:
        sides = " × ".join(f"{units.shown(side, LENGTH):g}" for side in header.walls.tolist())
        lines.append(f"- Walls with sides {sides} {units.unit(LENGTH)}".rstrip() + ".")
    if header.box is not None:
        box = zip("xyz", header.box.tolist(), strict=True)
        periods = [f"{axis} with {units.text(side, LENGTH, 'g')}" for axis, side in box if side < ENDLESS]
        lines.append(f"- Space is periodic along {in_series(periods)}.")
    if header.shear:
        rate = units.text(header.shear.rate, RATE, "g")
        lines.append(
            f"- It is sheared at {rate}: the mean velocity is along {header.shear.flow} and changes along "
            f"{header.shear.gradient}. The box is drawn at rest; its images along {header.shear.gradient} move."
        )
    return "\n".join(lines)


def _drawn(header: Header, si: str) -> str:
    """Return a space and the unit of recorded numbers, given the SI unit; empty for pure numbers."""
    unit = header.units.recorded_unit(si)
    return "" if unit == "1" else f" {unit}"


def _legend(header: Header) -> list[str]:
    lines = [f"- Bodies: {_body_colours(header)}."]
    if header.collides and header.engine:
        lines.append("- Lines join the centres of touching bodies.")
    elif header.collides:
        lines.append("- Lines (vermilion) join the centres of bodies that touch.")
    if header.records_contacts:
        lines += _impulse_legend(header)
    if header.has_torque:
        lines.append(
            "- Contacts that last turn bodies by a torque: an orange, thick arrow. The angular acceleration has the "
            f"same direction{_beside(header)}; its arrow, green and thin, is hidden."
        )
    if header.has_torque and header.records_contacts:
        lines.append(
            "- Impacts turn them by an angular impulse, which does not depend on the length of the step as a torque "
            "would: a magenta, thick arrow. The change of spin has the same direction; its arrow, crimson and thin, is "
            "hidden."
        )
    if header.has_torque:
        lines.append(
            "- The eye beside its name in the panel of the blueprint shows a hidden arrow, as does "
            "`carom view --arrows both`."
        )
    if shape(header) == "mesh":
        lines.append("- Dark and light halves of a sphere show how it turns.")
    if header.collides and not header.engine:
        stages = ", ".join(f"{k} {name}" for k, name in enumerate(palette.STAGE_NAMES))
        lines.append(
            "- Lines have another recorded colour, which `carom view --edges stage` shows: the stage in which the "
            f"solver resolves the contact, {stages}, then again from the start; white is the last, serial stage (past "
            f"{palette.SERIAL_STAGE})."
        )
    return lines


def _beside(header: Header) -> str:
    """Say where a reader finds both magnitudes of an arrow."""
    return (
        ", and selecting an arrow shows both magnitudes" if is_crowded(header) else ", and its number beside that arrow"
    )


def _contacts(header: Header) -> str:
    """List the contact coefficients of each pair of materials; empty without [[material]]."""
    if header.materials is None or not header.collides:
        return ""
    lines = ["## Contacts", "| | e | μs | μk |", "|---|---|---|---|"]
    for kind in header.materials.contacts:
        values = " | ".join(f"{value:.4g}" for value in kind.coefficients)
        lines.append(f"| {literal(str(kind))} | {values} |")
    return "\n".join(lines)


def _impulse_legend(header: Header) -> list[str]:
    """Explain how impulses and impacts are drawn."""
    longest, joules = header.units.text(arrow_length(header, FORCE_NORMAL), LENGTH, ".4g"), _drawn(header, "J")
    friction = ", and the friction on it (purple)" if header.has_friction else ""
    lines = [
        "- The brighter a line, the larger the normal impulse J of the contact in the step; in the view of impulses, "
        "lines are wider, too, so that chains of wide lines carry the load. From dark (u = 0) to bright (1), u = s / "
        "(1 + s), s = (J / m_ref)^(1/3); m_ref is the median of the frame.",
        "- The contacts of the largest impulses have arrows at the contact point: the normal impulse on the second "
        f"body, or out of a plane or wall (yellow){friction}, {longest} · u long.",
    ]
    if header.engine:
        return [*lines, "- An impulse is the force that the engine reports, times the time since the previous frame."]
    return [
        *lines,
        "- Points are impacts, each where the two touched: as large as the impulse (m_ref is `impacts` in the "
        "property `arrows`), and yellow like arrows of normal impulses. Their recorded colours are as bright as "
        f"the energy lost (m_ref{' in' if joules else ''}{joules} is `impacts.energy`). On the timeline "
        "`impact`, each step is the next impact.",
    ]


def _body_colours(header: Header) -> str:
    if shape(header) == "mesh":
        return "one colour for all of them, since there are so many"
    match header.coloured_by:
        case "material" if header.materials:
            pairs = zip(header.materials.names, header.materials.colours, strict=True)
            return "by material, " + ", ".join(f"{literal(name)} {palette.name_of(colour)}" for name, colour in pairs)
        case "graph":
            return "the body's colour in the collision graph, or grey without contacts"
        case "island":
            return "one colour for bodies that are connected by contacts, or grey without contacts"
        case "speed":
            return "by speed, from violet to green; the colour in the middle is the median speed of the first frame"
    if header.bodies <= len(palette.BODIES) and any(header.names):
        each = zip(header.names, palette.BODIES, strict=False)
        return ", ".join(f"{literal(name or f'body {k}')} {palette.name_of(hue)}" for k, (name, hue) in enumerate(each))
    return "a hue for each group and each single body, in turns, and a shade for each body"
