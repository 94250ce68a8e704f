"""The static entities of a recording: texts, sizes, colours, names of series, and the document at /scene."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
import rerun as rr
from rerun.components import FillMode

from carom.arrays import FloatArray, SingleArray
from carom.recording.layout import force_arrows, turning_arrows
from carom.recording.layout.drawing import arrow_length, line_radii, shape, single
from carom.recording.layout.plot_views import curve_style
from carom.recording.read.statics import encode_bodies, encode_names
from carom.recording.schema import palette, paths
from carom.recording.schema.header import STATIC_COLOURS, Header, Scalar, TimeScale
from carom.recording.schema.paths import ANGULAR_ACCELERATION, FORCE_NORMAL, TORQUE
from carom.recording.schema.properties import stated
from carom.recording.schema.series import recorded
from carom.scene.portable_math import ENDLESS
from carom.scene.units.dimension import LENGTH, MASS, RATE, TIME
from carom.scene.wall_shapes import SIDES, Mesh, shape_called
from carom.scene.wording import in_series, literal

Static = tuple[str, rr.AsComponents]

_FORCE, _THICKNESS = (
    0.05,
    {  # of arrows, in median body radii; of two parallel ones, the shorter is thicker
        paths.TORQUE: 0.16,
        paths.ANGULAR_ACCELERATION: 0.07,
        paths.ANGULAR_IMPULSE: 0.16,
        paths.SPIN_CHANGE: 0.07,
    },
)
_EDGE_POINTS = 2.5  # width of a contact's line in points of the screen
_TRANSLUCENT = 0x8A93A638  # walls in front of bodies
_SECTORS, _SHADE = 16, 0x505050FF  # of walls that rotate
_PLANE_REACH = 1.5  # half-width of a plane's grid, in units of `reach`
_MESH_RINGS = 8  # from pole to pole; enough for one sphere among thousands to look round


def statics(header: Header, clock: TimeScale, origin: FloatArray, reach: float) -> Iterable[Static]:
    """Yield the static data, entity by entity; initially all bodies are within ``reach`` (m) of the origin."""
    yield paths.SCENE, rr.TextDocument(_scene_document(header, clock, origin), media_type=rr.MediaType.MARKDOWN)
    yield paths.SCENE_TOML, rr.TextDocument(header.scene_toml, media_type=rr.MediaType.TEXT)
    yield paths.WORLD, rr.ViewCoordinates.RIGHT_HAND_Z_UP
    yield from _bodies(header)
    yield from _surroundings(header, origin, reach)
    state = {name: getattr(header, name) for name in ("group", "mass", "radius", "inertia")}
    state |= {} if header.fixed is None else {"fixed": header.fixed}
    yield paths.STATIC_STATE, rr.AnyValues(**encode_names(header.names), **state)
    if header.data:
        yield paths.GIVEN_STATE, rr.AnyValues(**encode_bodies(header.data))
    yield from arrow_styles(header)
    if header.collides:
        yield paths.CONTACTS, rr.LineStrips3D.from_fields(radii=rr.Radius.ui_points(_EDGE_POINTS))
    for series in recorded(header):
        yield series.path, curve_style(series.legend, series.colour, series.width)
    yield paths.PHASE, _states(palette.PHASES)
    yield paths.DT_LIMIT, _states(palette.DT_LIMITS)


# values of the property `carom`
def identity(header: Header, clock: TimeScale, origin: FloatArray) -> dict[str, Scalar | FloatArray]:
    """Return the property `carom`: the scene, the parts of its model, and the style of its drawing."""
    properties: dict[str, Scalar | FloatArray] = {**stated(header), "time_scale": clock.scale, "origin": origin}
    arrows = *turning_arrows(header), *force_arrows(header)
    return properties | {f"arrow_length.{path}": arrow_length(header, path) for path in arrows}


def _bodies(header: Header) -> Iterable[Static]:
    is_static = header.coloured_by in STATIC_COLOURS
    colours = header.static_colours(header.coloured_by) if is_static else None
    radius = single(header.radius)
    match shape(header):
        case "ellipsoids":
            half_sizes = np.repeat(radius, 3).reshape(-1, 3)
            see_through = header.has_orientation or header.collides
            fill = FillMode.TransparentFillMajorWireframe if see_through else FillMode.Solid
            spheres = rr.Ellipsoids3D.from_fields(
                half_sizes=half_sizes,
                colors=colours,
                fill_mode=fill,
                line_radii=rr.Radius.ui_points(0.75),
                labels=list(header.names),
                show_labels=False,
            )
            yield paths.BODIES, spheres
        case "points":
            yield paths.BODIES, rr.Points3D.from_fields(radii=radius, colors=colours)
        case _:
            yield paths.BODIES, _two_tone_sphere()


def _surroundings(header: Header, origin: FloatArray, reach: float) -> Iterable[Static]:
    """Draw the walls or the periodic box, and each plane as a square grid."""
    wire: dict[str, Any] = {
        "colors": palette.GREY,
        "radii": rr.Radius.ui_points(1.0),
        "fill_mode": FillMode.MajorWireframe,
    }
    for path, size in ((paths.WALLS, header.walls), (paths.PERIODIC_BOX, header.drawn_box)):
        if size is not None:
            yield path, rr.Boxes3D(centers=[-origin], sizes=[size], **wire)
    yield from plane_grids(header, origin, np.zeros(3), reach)
    if header.shapes:
        meshes = [shape_called(wall.shape).mesh(wall.section, origin, _PLANE_REACH * reach) for wall in header.shapes]
        for k, mesh in enumerate(meshes) if header.drives else ():
            yield _wall(f"{paths.MOVING}/wall-{k}", header, mesh, origin)
        first = np.cumsum([0, *(len(mesh.corners) for mesh in meshes[:-1])])
        together = rr.Mesh3D(
            vertex_positions=np.concatenate([mesh.corners for mesh in meshes]) - origin,
            triangle_indices=np.concatenate([mesh.triangles + k for mesh, k in zip(meshes, first, strict=True)]),
            albedo_factor=_TRANSLUCENT,
        )
        yield paths.SHAPES, together


def _wall(path: str, header: Header, mesh: Mesh, origin: FloatArray) -> Static:
    """Draw a wall by itself; one that rotates has darker sectors, which show it."""
    motion = header.motions.get(path)
    sector = np.arange(len(mesh.corners)) % SIDES * _SECTORS // SIDES
    shades = np.where(sector % 2 == 0, np.uint32(palette.WHITE), np.uint32(_SHADE))
    return path, rr.Mesh3D(
        vertex_positions=mesh.corners - origin,
        triangle_indices=mesh.triangles,
        vertex_colors=shades if motion is not None and motion.rotation != 0.0 else None,
        albedo_factor=_TRANSLUCENT,
    )


def plane_grids(header: Header, origin: FloatArray, centre: FloatArray, reach: float) -> Iterable[Static]:
    """Draw each plane as a square grid about the point nearest to a centre, (3,) m from the origin.

    All bodies are within ``reach`` (m) of the centre.
    """
    if header.planes is not None and len(header.planes):
        planes = zip(header.planes.normal, header.planes.offset, strict=True)
        grids = [_grid(normal, offset - normal @ origin, centre, reach) for normal, offset in planes]
        radii = rr.Radius.ui_points(0.6)
        for k, grid in enumerate(grids) if header.drives else ():
            yield f"{paths.MOVING}/plane-{k}", rr.LineStrips3D(grid, colors=palette.GREY, radii=radii)
        yield paths.PLANES, rr.LineStrips3D(np.concatenate(grids), colors=palette.GREY, radii=radii)


def _grid(normal: FloatArray, offset: float, centre: FloatArray, reach: float) -> SingleArray:
    """Return lines (k, 2, 3) of a square grid on a plane, about the point nearest to a centre."""
    across = np.cross(normal, np.eye(3)[np.argmin(np.abs(normal))])
    across /= np.linalg.norm(across)
    along = np.cross(normal, across)
    marks = np.linspace(-_PLANE_REACH * reach, _PLANE_REACH * reach, paths.PLANE_LINES)
    ends = np.array([marks[0], marks[-1]])
    one = marks[:, None, None] * across + ends[None, :, None] * along
    other = marks[:, None, None] * along + ends[None, :, None] * across
    nearest = centre + (offset - normal @ centre) * normal
    return np.asarray(nearest + np.concatenate((one, other)), dtype=np.float32)


def _two_tone_sphere() -> rr.Mesh3D:
    """Return a unit sphere with one dark half, which makes rotation visible."""
    polar = np.linspace(0.0, np.pi, _MESH_RINGS + 1)
    around = np.linspace(0.0, 2.0 * np.pi, 2 * _MESH_RINGS, endpoint=False)
    theta, phi = np.meshgrid(polar, around, indexing="ij")
    vertices = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=-1)
    vertices = vertices.reshape(-1, 3).astype(np.float32)
    ring, slot = np.meshgrid(np.arange(_MESH_RINGS), np.arange(len(around)), indexing="ij")
    following = (slot + 1) % len(around)
    a, b = ring * len(around) + slot, ring * len(around) + following
    c, d = a + len(around), b + len(around)
    triangles = np.concatenate([np.stack([a, c, b], axis=-1), np.stack([b, c, d], axis=-1)]).reshape(-1, 3)
    light = vertices[:, 0] >= 0
    return rr.Mesh3D(
        vertex_positions=vertices,
        triangle_indices=triangles.astype(np.uint32),
        vertex_normals=vertices,
        vertex_colors=np.where(light, np.uint32(palette.SKY), np.uint32(palette.BLUE)),
    )


def arrow_styles(header: Header, theme: str = "dark") -> Iterable[Static]:
    """Yield the widths and colours of the arrows that a recording has."""
    for path in (*turning_arrows(header), *force_arrows(header)):
        thickness = _THICKNESS.get(path, _FORCE)
        (colour,) = palette.legible([palette.ARROWS[path]], theme).tolist()
        width = line_radii(thickness, float(np.median(header.radius)))
        yield path, rr.Arrows3D.from_fields(radii=width, colors=colour)


def _states(colours: dict[str, int]) -> rr.StateConfiguration:
    return rr.StateConfiguration(values=list(colours), colors=np.array(list(colours.values()), dtype=np.uint32))


def _scene_document(header: Header, clock: TimeScale, origin: FloatArray) -> str:
    """Return the text at /scene, in Markdown: the run, the scales and the colours."""
    about = "\n".join(literal(line) for line in header.description.strip().splitlines())
    parts = [f"# {literal(header.title)}", about, _run(header), _data(header)]
    parts += [_scales(header, clock, origin), _legend(header), _contacts(header)]
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
    """List the notes on data files (unused or reinterpreted columns); empty without any."""
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
    if header.has_torque:
        lines.append(
            "- Arrows start at a body's centre. What sticks out of the sphere is L = L_max · s / (1 + s) long, with "
            f"s = (m / m_ref)^⅓. L_max is {units.text(arrow_length(header, TORQUE), LENGTH, '.4g')} for torques and "
            f"angular impulses, {units.text(arrow_length(header, ANGULAR_ACCELERATION), LENGTH, '.4g')} for angular "
            "accelerations and changes of spin; m_ref stands in the recording's property `arrows`, and the magnitude m "
            "beside each arrow."
        )
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
    """Return the unit of recorded numbers, after a space, given its name in SI; empty for pure numbers."""
    unit = header.units.recorded_unit(si)
    return "" if unit == "1" else f" {unit}"


def _legend(header: Header) -> str:
    lines = ["## Colours", f"- Bodies: {_body_colours(header)}."]
    if header.collides and header.engine:
        lines.append("- Lines join the centres of touching bodies.")
    elif header.collides:
        stages = ", ".join(f"{k} {name}" for k, name in enumerate(palette.STAGE_NAMES))
        lines.append(
            f"- Lines join the centres of touching bodies. Their recorded colour, which `--edges stage` shows, is the "
            f"stage in which the contact is resolved: {stages}, then again from the start; white is the last, serial "
            f"stage (past {palette.SERIAL_STAGE})."
        )
    if header.records_contacts:
        lines += _impulse_legend(header)
    if header.has_torque:
        lines.append(
            "- Contacts that last turn bodies by a torque: an orange, thick arrow, with the angular acceleration, "
            "green and thin."
        )
    if header.has_torque and header.records_contacts:
        lines.append(
            "- Impacts turn them by an angular impulse, which does not depend on the length of the step as a torque "
            "would: a magenta, thick arrow, with the change of spin, crimson and thin."
        )
    if shape(header) == "mesh":
        lines.append("- Dark and light halves of a sphere show how it turns.")
    return "\n".join(lines)


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
        "- Both views colour these lines by the normal impulse J of the step; that of impulses draws wider lines, too: "
        "u = s / (1 + s), s = (J / m_ref)^⅓, from dark purple (u = 0) over red (⅓) and orange (⅔) to pale yellow (1). "
        "Chains of wide lines carry the load. m_ref is the median of the frame.",
        "- The contacts of the largest impulses have arrows at the contact point: the normal impulse on the second "
        f"body (yellow){friction}, {longest} · u long.",
    ]
    if header.engine:
        return [*lines, "- An impulse is the force that the engine reports, times the time since the frame before."]
    return [
        *lines,
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
            return "by material, " + ", ".join(f"{literal(name)} {palette.name_of(colour)}" for name, colour in pairs)
        case "graph":
            return "the body's colour in the collision graph, or grey without contacts"
        case "island":
            return "one colour for bodies that are connected by contacts, or grey without contacts"
        case "speed":
            return "by speed, from violet to yellow; the colour in the middle is the median speed of the first frame"
    return "a hue for each group and each single body, in turns, and a shade for each body"
