"""The static entities of a recording: texts, sizes, colours, names of series."""

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
from carom.recording.schema.paths import ENTRY
from carom.recording.schema.properties import stated
from carom.recording.schema.series import recorded
from carom.recording.write.recorded_texts import about_document, legend_document, scene_document
from carom.scene.wall_shapes import SIDES, Mesh, shape_called

Static = tuple[str, rr.AsComponents]

_THICKNESS = {  # radii of arrows, in median body radii; of two parallel arrows, the shorter is thicker
    **dict.fromkeys((paths.TORQUE, paths.ANGULAR_IMPULSE), 0.16),
    **dict.fromkeys((paths.ANGULAR_ACCELERATION, paths.SPIN_CHANGE), 0.07),
    **dict.fromkeys((paths.FORCE_NORMAL, paths.FORCE_FRICTION), 0.05),
}
_EDGE_POINTS = 2.5  # width of a contact's line, in screen points
_TRANSLUCENT = 0x8A93A624  # colour of walls in front of bodies
_POINT = 1e-9  # fraction of a wall's extent; corners that are closer together count as one, such as at a pole
_BENT = 0.35  # 2 sin ½β, β = 20°: edges that bend less are not drawn; a surface of revolution bends by 4° at each edge
_SECTORS, _SHADE = 16, 0x505050FF  # number of sectors, and colour of shaded sectors, on walls that rotate
_PLANE_REACH = 1.5  # half-width of a plane's grid, in units of `reach`
_MESH_RINGS = 8  # rings from pole to pole; enough for one sphere among thousands to look round


def statics(header: Header, clock: TimeScale, origin: FloatArray, reach: float) -> Iterable[Static]:
    """Yield the static data, entity by entity; initially all bodies are within ``reach`` (m) of the origin."""
    for path, text in (
        (paths.ABOUT, about_document(header, clock)),
        (paths.LEGEND, legend_document(header)),
        (paths.SCENE, scene_document(header, clock, origin)),
    ):
        yield path, rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN)
    yield paths.SCENE_TOML, rr.TextDocument(header.scene_toml, media_type=rr.MediaType.TEXT)
    yield paths.WORLD, rr.ViewCoordinates.RIGHT_HAND_Z_UP
    yield from _bodies(header)
    yield from _surroundings(header, origin, reach)
    state = {name: getattr(header, name) for name in ("group", "mass", "radius", "inertia")}
    flags = {"fixed": header.fixed, "judged": header.judged}
    state |= {name: mask for name, mask in flags.items() if mask is not None}
    if header.entries is not None:
        state |= {f"{ENTRY}{name}": values.ravel() for name, values in header.entries._asdict().items()}
    yield paths.STATIC_STATE, rr.AnyValues(**encode_names(header.names), **state)
    if header.data:
        yield paths.GIVEN_STATE, rr.AnyValues(**encode_bodies(header.data))
    yield from arrow_styles(header)
    if header.collides:
        yield paths.CONTACTS, rr.LineStrips3D.from_fields(radii=rr.Radius.ui_points(_EDGE_POINTS))
    for series in recorded(header):
        yield series.path, curve_style(series.name_in(header), series.colour, series.width)
    yield paths.PHASE, _states(palette.PHASES)
    yield paths.DT_LIMIT, _states(palette.DT_LIMITS)


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
        rims = [np.concatenate((_rims(mesh), mesh.corners[mesh.lines])) - origin for mesh in meshes]
        entities = [f"{paths.MOVING}/wall-{k}" for k in range(len(rims))] if header.drives else []
        for path, lines in ((paths.SHAPES, np.concatenate(rims)), *zip(entities, rims, strict=False)):
            if len(lines):
                yield path, rr.LineStrips3D(single(lines), colors=palette.GREY, radii=rr.Radius.ui_points(1.0))


def _rims(mesh: Mesh) -> FloatArray:
    """Return the lines at borders and edges of a surface, (k, 2, 3) m, without which a translucent cup looks flat."""
    grain = _POINT * float(np.ptp(mesh.corners, axis=0).max())
    _, first, number = np.unique(np.round(mesh.corners / grain), axis=0, return_index=True, return_inverse=True)
    corners, triangles = mesh.corners[first], number.reshape(-1)[mesh.triangles]
    triangles = triangles[(triangles != np.roll(triangles, 1, axis=1)).all(axis=1)]
    begin, end, apex = (np.roll(triangles, -k, axis=1).reshape(-1) for k in range(3))
    along, inward = corners[end] - corners[begin], corners[apex] - corners[begin]
    inward -= ((inward * along).sum(axis=1) / (along * along).sum(axis=1))[:, None] * along
    inward /= np.maximum(np.linalg.norm(inward, axis=1), grain)[:, None]
    edges, edge = np.unique(np.minimum(begin, end) * len(corners) + np.maximum(begin, end), return_inverse=True)
    bend = np.stack([np.bincount(edge.reshape(-1), inward[:, k]) for k in range(3)], axis=1)  # 0 where it is flat
    drawn = edges[np.linalg.norm(bend, axis=1) > _BENT]
    return np.asarray(corners[np.stack((drawn // len(corners), drawn % len(corners)), axis=1)])


def _wall(path: str, header: Header, mesh: Mesh, origin: FloatArray) -> Static:
    """Draw a wall by itself; if it rotates, darker sectors show the rotation."""
    motion = header.motions.get(path)
    sector = np.arange(len(mesh.corners)) % SIDES * _SECTORS // SIDES
    shades = np.where(sector % 2 == 0, np.uint32(palette.WHITE), np.uint32(_SHADE))
    return path, rr.Mesh3D(
        vertex_positions=mesh.corners - origin,
        triangle_indices=mesh.triangles,
        vertex_colors=shades if motion is not None and motion.rotation != 0.0 else None,
        albedo_factor=_TRANSLUCENT,
    )


def grid_spacing(reach: float) -> float:
    """Return the side (m) of a square of the grid on a plane whose bodies are within ``reach`` (m)."""
    return 2.0 * _PLANE_REACH * reach / (paths.PLANE_LINES - 1)


def plane_grids(
    header: Header, origin: FloatArray, centre: FloatArray, reach: float, theme: str = "dark"
) -> Iterable[Static]:
    """Draw each plane as a square grid about the point nearest to a centre, (3,) m from the origin.

    All bodies are within ``reach`` (m) of the centre.
    """
    if header.planes is not None and len(header.planes):
        planes = zip(header.planes.normal, header.planes.offset, strict=True)
        grids = [_grid(normal, offset - normal @ origin, centre, reach) for normal, offset in planes]
        radii, colour = rr.Radius.ui_points(0.6), palette.GRIDS[theme]
        for k, grid in enumerate(grids) if header.drives else ():
            yield f"{paths.MOVING}/plane-{k}", rr.LineStrips3D(grid, colors=colour, radii=radii)
        yield paths.PLANES, rr.LineStrips3D(np.concatenate(grids), colors=colour, radii=radii)


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
        thickness = _THICKNESS[path]
        (colour,) = palette.legible([palette.ARROWS[path]], theme).tolist()
        width = line_radii(thickness, float(np.median(header.radius)))
        yield path, rr.Arrows3D.from_fields(radii=width, colors=colour)


def _states(colours: dict[str, int]) -> rr.StateConfiguration:
    return rr.StateConfiguration(values=list(colours), colors=np.array(list(colours.values()), dtype=np.uint32))
