"""Static data, logged once: texts, sizes, colours, names of series."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import rerun as rr
from numpy.typing import NDArray
from rerun.components import FillMode

from carom.recording.schema import palette, paths
from carom.recording.schema.clock import Clock
from carom.recording.schema.header import STATIC_COLOURS, Header, Scalar, scene_digest
from carom.recording.schema.series import recorded
from carom.recording.schema.stored_bodies import encode_bodies, encode_names
from carom.recording.style.arrow_length import arrow_length
from carom.recording.style.body_shape import shape
from carom.recording.style.curve_style import curve_style
from carom.recording.style.line_radii import line_radii
from carom.recording.style.single_precision import single
from carom.recording.write.scene_text import scene_document
from carom.scene.extensions import PROPERTY
from carom.scene.forces import FORCES, GRAVITY, UNIFORM_FIELD

Static = tuple[str, rr.AsComponents]

_THICK, _THIN, _FORCE = 0.16, 0.07, 0.05  # of an arrow, in median body radii
_EDGE_POINTS = 2.5  # width of a contact's line in points of the screen
_PLANE_REACH = 1.5  # half-width of a plane's grid, in units of `reach`
_MESH_RINGS = 8  # from pole to pole; enough for a sphere among thousands to look round


def statics(header: Header, clock: Clock, origin: NDArray[np.float64], reach: float) -> Iterable[Static]:
    """Yield everything static, entity by entity; at the start all bodies are within ``reach`` (m) of the origin."""
    yield (
        paths.SCENE,
        rr.TextDocument(scene_document(header, clock, origin), media_type=rr.MediaType.MARKDOWN),
    )
    yield paths.SCENE_TOML, rr.TextDocument(header.scene_toml, media_type=rr.MediaType.TEXT)
    yield paths.WORLD, rr.ViewCoordinates.RIGHT_HAND_Z_UP
    yield from _bodies(header)
    yield from _surroundings(header, origin, reach)
    yield (
        paths.STATIC_STATE,
        rr.AnyValues(
            **encode_names(header.names),
            group=header.group,
            mass=header.mass,
            radius=header.radius,
            inertia=header.inertia,
        ),
    )
    if header.data:
        yield paths.GIVEN_STATE, rr.AnyValues(**encode_bodies(header.data))
    if header.has_torque:
        yield paths.TORQUE, _arrow_style(header, _THICK, palette.ORANGE)
        yield paths.ANGULAR_ACCELERATION, _arrow_style(header, _THIN, palette.GREEN)
    if header.collides:
        yield paths.CONTACTS, rr.LineStrips3D.from_fields(radii=rr.Radius.ui_points(_EDGE_POINTS))
    if header.records_contacts:
        yield paths.FORCE_NORMAL, _arrow_style(header, _FORCE, palette.SKY)
        if header.has_friction:
            yield paths.FORCE_FRICTION, _arrow_style(header, _FORCE, palette.GREEN)
    yield from _series(header)
    yield paths.PHASE, _states(palette.PHASES)
    yield paths.DT_LIMIT, _states(palette.DT_LIMITS)


def identity(header: Header, clock: Clock, origin: NDArray[np.float64]) -> dict[str, Scalar | NDArray[np.float64]]:
    """Return the property `carom`: what the scene is, which parts of the model it has, and how it is drawn."""
    properties: dict[str, Scalar | NDArray[np.float64]] = {
        "schema_version": paths.SCHEMA_VERSION,
        "title": header.title,
        "bodies": header.bodies,
        "seed": header.seed,
        "spins": header.spins,
        "has_orientation": header.has_orientation,
        "has_torque": header.has_torque,
        "has_friction": header.has_friction,
        GRAVITY.present: GRAVITY.name in header.forces,
        "collides": header.collides,
        "stabilises": header.stabilises,
        UNIFORM_FIELD.present: UNIFORM_FIELD.name in header.forces,
        "body_colouring": header.body_colouring,
        "colour_by": header.coloured_by,
        "records_contacts": header.records_contacts,
        "duration": float(header.duration),
        "time_scale": clock.scale,
        "origin": origin,
    }
    if header.scene_toml:
        properties["scene_sha256"] = scene_digest(header.scene_toml)
    if header.engine:
        properties["engine"] = header.engine
        if header.planes is not None:
            properties["plane_names"] = "\n".join(header.planes.name)
    properties |= header.units.properties()
    properties |= {f"data_notes.{k}": "\n".join(notes) for k, notes in enumerate(header.data_notes) if notes}
    if header.check_interval is not None:
        properties["check_interval"] = header.check_interval
    if header.promises:
        properties["promises"] = True
    properties |= {kind.present: True for kind in FORCES if kind.name in header.forces}
    properties |= {f"{PROPERTY}{part}": package for part, package in header.extensions.items()}
    if header.has_torque:
        for path in (paths.TORQUE, paths.ANGULAR_ACCELERATION):
            properties[f"arrow_length.{path}"] = arrow_length(header, path)
    if header.records_contacts:
        for path in (paths.FORCE_NORMAL, *((paths.FORCE_FRICTION,) if header.has_friction else ())):
            properties[f"arrow_length.{path}"] = arrow_length(header, path)
    if header.box is not None:
        properties["box"] = header.box
    return properties


def _bodies(header: Header) -> Iterable[Static]:
    is_static = header.coloured_by in STATIC_COLOURS
    colours = header.static_colours(header.coloured_by) if is_static else None
    radius = single(header.radius)
    match shape(header):
        case "ellipsoids":
            half_sizes = np.repeat(radius, 3).reshape(-1, 3)
            see_through = header.has_orientation or header.collides
            fill = FillMode.TransparentFillMajorWireframe if see_through else FillMode.Solid
            yield (
                paths.BODIES,
                rr.Ellipsoids3D.from_fields(
                    half_sizes=half_sizes,
                    colors=colours,
                    fill_mode=fill,
                    line_radii=rr.Radius.ui_points(0.75),
                    labels=list(header.names),
                    show_labels=False,
                ),
            )
        case "points":
            yield paths.BODIES, rr.Points3D.from_fields(radii=radius, colors=colours)
        case _:
            yield paths.BODIES, _two_tone_sphere()


def _surroundings(header: Header, origin: NDArray[np.float64], reach: float) -> Iterable[Static]:
    """Draw the walls or the periodic box, and each plane as a square grid."""
    for path, size in ((paths.WALLS, header.walls), (paths.PERIODIC_BOX, header.box)):
        if size is not None:
            yield (
                path,
                rr.Boxes3D(
                    centers=[-origin],
                    sizes=[size],
                    colors=palette.GREY,
                    radii=rr.Radius.ui_points(1.0),
                    fill_mode=FillMode.MajorWireframe,
                ),
            )
    yield from plane_grids(header, origin, np.zeros(3), reach)


def plane_grids(
    header: Header, origin: NDArray[np.float64], centre: NDArray[np.float64], reach: float
) -> Iterable[Static]:
    """Draw each plane as a square grid about the point nearest to a centre, (3,) m from the origin.

    ``reach`` is that of the bodies around the centre, in m.
    """
    if header.planes is not None and len(header.planes):
        planes = zip(header.planes.normal, header.planes.offset, strict=True)
        grids = [_grid(normal, offset - normal @ origin, centre, reach) for normal, offset in planes]
        yield (
            paths.PLANES,
            rr.LineStrips3D(np.concatenate(grids), colors=palette.GREY, radii=rr.Radius.ui_points(0.6)),
        )


def _grid(normal: NDArray[np.float64], offset: float, centre: NDArray[np.float64], reach: float) -> NDArray[np.float32]:
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
    """Make a unit sphere with one dark half, so that rotation is visible."""
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


def _arrow_style(header: Header, thickness: float, colour: int) -> rr.Arrows3D:
    return rr.Arrows3D.from_fields(radii=line_radii(thickness, float(np.median(header.radius))), colors=colour)


def _series(header: Header) -> Iterable[Static]:
    for series in recorded(header):
        yield series.path, curve_style(series.legend, series.colour, series.width)


def _states(colours: dict[str, int]) -> rr.StateConfiguration:
    return rr.StateConfiguration(values=list(colours), colors=np.array(list(colours.values()), dtype=np.uint32))
