"""Parts that pictures and movies share: the camera, grids, trails, plots, the arrow of a field, and body names.

Plots have content that is not in the file: a strip of the impacts, and logarithms of growing energies.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from carom.arrays import ColourArray, FloatArray, IntArray
from carom.display.request import ShownStep
from carom.display.supplement import Static, Trails, has_trails
from carom.recording.layout import FIELD
from carom.recording.layout.camera import CameraFit
from carom.recording.layout.canvas import Area, CameraMotion, LensView, View, turned, views_of
from carom.recording.layout.drawing import line_radii, shape, single
from carom.recording.layout.plot_views import DECADES, CurveOutline, Curves, curve_style, grows_by_decades, shown_series
from carom.recording.read.frame_rows import RecordedPositions
from carom.recording.read.recorded_impacts import impacts_by_number
from carom.recording.read.recording import Recording
from carom.recording.schema import palette, paths
from carom.recording.schema.header import Header
from carom.recording.schema.paths import STEP
from carom.recording.schema.series import PLOTS
from carom.recording.write.rows import Index, Rows
from carom.recording.write.static_entities import plane_grids
from carom.scene.units import dimension

_LOOKS = 50  # frames of many bodies to which the camera is fitted
MOST_BANDS = 100
MOST_POINTS = 1000  # of impacts; with a few more, a picture takes the software driver seconds
_BANDS = (palette.ORANGE, palette.YELLOW)  # of alternate impacts
MOST_NAMES = 12
_ROW, _LETTER = 24.0, 7.5  # points, height of a label and width of a letter
_LENGTH = 0.16  # of the field's arrow, in heights of the view; axes are 0.6 times as long
_AXES = np.array([0xD42A1EFF, 0x0FA35AFF, 0x4A66F0FF], dtype=np.uint32)  # x, y, z


@dataclass(frozen=True, slots=True)
class Staging:
    """A camera fitted to the motion in a recording, and additions to the bodies."""

    camera: CameraFit
    trails: Trails | None  # of few bodies
    header: Header
    origin: FloatArray  # (3,) m, of the recording

    @classmethod
    def of(
        cls,
        recording: Recording,
        header: Header,
        first: FloatArray,
        colours: ColourArray,
        until: float = np.inf,
        motion: CameraMotion | None = None,
        repeated: ShownStep | None = None,
    ) -> Staging:
        """Fit a camera to a recording.

        Parameters
        ----------
        first
            (n, 3) m from the origin, positions that must be in view.
        colours
            (n,) colours of the trails.
        until
            s, the time up to which the motion should be in view.
        motion
            The camera's motion; by default it depends on the scene.
        repeated
            A step of which there may be no frame, for the trails to lead to its bodies.
        """
        camera = CameraFit.of_scene(header, recording.origin, first, motion)
        trails = Trails(recording, header, colours, repeated) if has_trails(recording) else None
        if trails is not None:
            trails.show(camera, until)
            # without contacts, show whole orbits: all bodies may be near their pericentres now
            if not header.collides or recording.closing.get("contacts.total") == 0:
                camera.show_all()
        elif recording.frames > 1:
            drawn, table = RecordedPositions(recording), recording.fingerprints()
            for row in np.unique(np.linspace(0, table.num_rows - 1, _LOOKS).astype(int)):
                position = drawn.drawn(int(table[STEP][int(row)].as_py())) - recording.origin
                camera.look(position, inside=table["time"][int(row)].as_py() <= until)
        return cls(camera, trails, header, recording.origin)

    def rows(self) -> Iterator[Rows]:
        """Yield the trails."""
        if self.trails is not None:
            yield from self.trails.rows()

    def statics(self) -> Iterator[Static]:
        """Yield the colours of the trails, and the planes as grids where the camera looks.

        The recorded grids are centred on the initial bodies.
        """
        if self.header.walls is None and self.header.box is None:
            seen = self.camera.view()
            yield from plane_grids(self.header, self.origin, seen.target, 0.5 * seen.height())
        if self.trails is not None:
            yield from self.trails.statics()

    def camera_rows(
        self, layout: rrb.Blueprint, steps: IntArray, times: FloatArray, positions: Sequence[FloatArray]
    ) -> Iterator[Rows]:
        """Yield the poses of the cameras that move, for positions (n, 3), in m from the origin, of some frames."""
        for shown in views_of(layout.root_container):
            if not isinstance(shown, LensView) or shown.lens.view.motion is CameraMotion.STILL:
                continue
            view = shown.lens.view
            if view.motion is CameraMotion.FOLLOW:
                poses = [replace(view, target=view.target + self.camera.offset(each)) for each in positions]
            else:
                angles = np.linspace(0.0, 2.0 * np.pi, len(steps))
                poses = [replace(view, to_eye=turned(view.to_eye, view.up, angle)) for angle in angles]
            yield Rows(shown.lens.path, Index(steps, times), shown.lens.poses(poses))


def impact_strip(recording: Recording) -> tuple[Curves, list[Rows], list[Static]]:
    """Return the outline of impulses, a band from each impact to the next, and the colours of the bands.

    With more than `MOST_BANDS` impacts there are no bands, with more than `MOST_POINTS` there is no outline.
    """
    entries = [entry for entry in recording.store.entries if entry.entity_path == paths.IMPACTS]
    if not 0 < sum(entry.rows for entry in entries if not entry.is_static) <= MOST_POINTS:
        return {}, [], []
    numbers, _ = impacts_by_number(recording)
    impacts = recording.impacts()
    if impacts.num_rows != len(numbers):
        return {}, [], []
    index = Index(impacts[STEP].to_numpy(), impacts["time"].to_numpy())
    outline = {paths.IMPACTS: CurveOutline.of(index.times, impacts["normal_impulse"].to_numpy())}
    if len(numbers) > MOST_BANDS:
        return outline, [], []
    names = [f"impact {number}" for number in numbers.tolist()]
    colours = np.array([_BANDS[k % len(_BANDS)] for k in range(len(names))], dtype=np.uint32)
    rows = Rows(paths.IMPACTS, index, list(rr.StateChange.columns(state=names)))
    return outline, [rows], [(paths.IMPACTS, rr.StateConfiguration(values=names, colors=colours))]


def decades(recording: Recording, header: Header, curves: Curves) -> tuple[Curves, list[Rows], list[Static]]:
    """Return the logarithms of the energies with their outlines and styles; nothing unless they grow by decades."""
    series = shown_series(header, PLOTS[0][0], curves)
    if not grows_by_decades(curves[each.path] for each in series):
        return {}, [], []
    table = recording.energy()
    index = Index(table[STEP].to_numpy(), table["time"].to_numpy())
    outlines, rows = dict[str, CurveOutline](), list[Rows]()
    statics: list[Static] = []
    for each in series:
        with np.errstate(divide="ignore"):
            values = np.log10(np.abs(table[each.path.rpartition("/")[2]].to_numpy() / header.plot_factor(each.unit)))
        values[~np.isfinite(values)] = np.nan
        path = f"{DECADES}/{each.path}"
        outlines[each.path] = CurveOutline.of(index.times, values)
        rows.append(Rows(path, index, list(rr.Scalars.columns(scalars=values))))
        statics.append((path, curve_style(each.legend, each.colour, each.width)))
    return outlines, rows, statics


def whole_span(recording: Recording) -> Sequence[float]:
    """Return the times (s) of the first and of the last frame."""
    times = recording.fingerprints()["time"].to_numpy()
    return [float(times[0]), float(times[-1])]


def field_arrows(
    header: Header,
    view: View,
    area: Area,
    field: FloatArray,
    drawn: FloatArray,
    radius: FloatArray,
    legend: tuple[int, int] | None = None,
) -> Iterator[Static]:
    """Draw a uniform field (3,) m/s² as an arrow at the upper border of a view, and the axes of space at the lower.

    Each is on the side where it covers less of what is ``drawn``, points (k, 3) m with radii (k,) m, and on the left if
    both are equal. In a corner with a legend, it is beside the legend.
    """
    height, size = view.height(), float(np.linalg.norm(field))
    right, up = view.axes()
    length = _LENGTH * height
    text = f"gravity, {header.units.text(size, dimension.ACCELERATION, '.4g')}"
    places, sizes = view.on_screen(drawn), view.radius_on_screen(drawn, radius)[:, None]
    reach = np.array([_LETTER * (len(text) + 1) / area.height, _LENGTH])  # half of the label and of the arrow
    origins = []
    for middle, extent, start in ((0.84 - _LENGTH, reach, 0.84), (-0.72, np.full(2, 1.5 * _LENGTH), -0.72)):
        aside = np.zeros(2)  # by how far the legend displaces it on each side
        if legend is not None and legend[1] * start > 0.0:
            aside[int(legend[0] > 0)] = -2.0 * legend[1] * area.inset_share[1]
        sides = [np.array([x * 0.72 * area.aspect, middle + down]) for x, down in zip((-1.0, 1.0), aside, strict=True)]
        covered = [np.all(np.abs(places - side) < extent + sizes, axis=1).sum() for side in sides]
        chosen = int(covered[1] < covered[0]) if covered[0] != covered[1] else int(aside[0] != 0.0)
        x, y = sides[chosen][0], start + aside[chosen]
        origins.append(view.target + 0.5 * height * (x * right + y * up))
    top, corner = origins
    vectors = np.vstack([length * field / size, 0.6 * length * np.eye(3)])
    theme = area.theme
    ink, arrow = palette.INKS[theme], palette.legible([palette.FIELD], theme)
    yield (
        FIELD,
        rr.Arrows3D(
            origins=single(np.stack([top, corner, corner, corner])),
            vectors=single(vectors),
            colors=np.concatenate([arrow, palette.legible(_AXES, theme)]),
            radii=line_radii(0.05 * length, 1.0),
        ),
    )
    texts = [text, "x", "y", "z"]
    ends = np.vstack([top + 0.5 * vectors[0], corner + 1.15 * vectors[1:]])
    labels = rr.Points3D(single(ends), radii=1e-6 * length, labels=texts, colors=ink, show_labels=True)
    yield f"{FIELD}/labels", labels


def names_that_fit(header: Header, position: FloatArray, view: View, area: Area) -> tuple[str, ...]:
    """Return the names (n,) of bodies at (n, 3) m if they are few, otherwise ().

    Of two names that would overlap in a view of this area, that of the smaller body is empty.
    """
    n = len(position)
    if not any(header.names) or n > MOST_NAMES or n != len(header.names) or shape(header) != "ellipsoids":
        return ()
    points = (position - view.target) @ view.axes().T * area.height / view.height()
    wide = np.array([_LETTER * (len(name) + 1) for name in header.names])
    across, up = np.abs(points[:, None] - points[None]).transpose(2, 0, 1)
    overlap = (across < (wide[:, None] + wide) / 2.0) & (up < _ROW)
    shown = np.zeros(n, dtype=bool)
    for k in np.argsort(-header.radius, kind="stable"):
        shown[k] = np.isfinite(points[k]).all() and not (overlap[k] & shown).any()
    return tuple(name if each else "" for name, each in zip(header.names, shown.tolist(), strict=True))
