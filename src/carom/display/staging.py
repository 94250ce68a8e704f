"""Parts that pictures and movies share: the camera, grids, trails, plots, axes, the arrow of a field, and body names.

Plots have content that is not in the file: a strip of the impacts, and logarithms of growing energies.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from carom.arrays import BoolArray, ColourArray, FloatArray
from carom.display.request import ShownStep
from carom.display.supplement import Static, Trails, has_trails
from carom.recording.layout import FIELD
from carom.recording.layout.camera import CameraFit
from carom.recording.layout.canvas import Area, CameraMotion, LensView, View, views_of
from carom.recording.layout.drawing import line_radii, shape, single
from carom.recording.layout.plot_views import CAPTION, DECADES, curve_style, grows_by_decades, shown_series
from carom.recording.read.frame_rows import RecordedPositions
from carom.recording.read.recorded_impacts import impacts_by_number
from carom.recording.read.recording import Recording
from carom.recording.schema import palette, paths
from carom.recording.schema.curve_outline import CurveOutline, Curves
from carom.recording.schema.header import Header, TimeScale
from carom.recording.schema.series import PLOTS
from carom.recording.timelines import STEP
from carom.recording.write.rows import NO_STEPS, Index, Rows
from carom.recording.write.static_entities import grid_spacing, plane_grids
from carom.scene.units import dimension
from carom.scene.units.system import UnitSystem

_LOOKS = 50  # number of frames, with many bodies, to which the camera is fitted
MOST_BANDS = 100
MOST_POINTS = 1000  # largest number of points of impacts; with more, the software driver takes seconds for a picture
_BANDS = (palette.IMPACTS, palette.YELLOW)  # colours of alternate impacts
MOST_NAMES = 16
_ROW, _LETTER = 24.0, 7.5  # points, height of a label and width of a letter
_LENGTH = 0.16  # length of the field's arrow, in heights of the view
_AXIS = 0.8  # largest length of the axes, in lengths of the field's arrow; at least 0.4, since lengths are rounded down
_BELOW = 0.14  # distance of the axes' corner from the border of the view, in heights of the view
_AXES = np.array([0xD42A1EFF, 0x0FA35AFF, 0x4A66F0FF], dtype=np.uint32)  # colours of x, y and z


@dataclass(frozen=True, slots=True)
class Staging:
    """A camera fitted to the motion in a recording, and additions to the bodies."""

    camera: CameraFit
    trails: Trails | None  # trails, if there are few bodies
    header: Header
    origin: FloatArray  # (3,) m, origin of the recording

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
            A step, possibly without a frame; the trails lead to its bodies.
        """
        camera = CameraFit.of_scene(header, recording.origin, first, motion)
        trails = Trails(recording, header, colours, repeated) if has_trails(recording) else None
        if trails is not None:
            trails.show(camera, until)
            # if the scene has no contacts, show whole orbits, since all bodies may be near their pericentres now
            if not header.collides or recording.closing.get("contacts.total") == 0:
                camera.show_all()
        elif recording.frames > 1:
            drawn, table = RecordedPositions(recording), recording.fingerprints()
            for row in np.unique(np.linspace(0, table.num_rows - 1, _LOOKS).astype(int)):
                position = drawn.drawn(int(table[STEP][int(row)].as_py())) - recording.origin
                camera.look(position, inside=table["time"][int(row)].as_py() <= until)
        return cls(camera, trails, header, recording.origin)

    @property
    def recent(self) -> float | None:
        """The time (s) for which trails are drawn; None for the whole past."""
        return None if self.trails is None else self.trails.recent

    def recent_of(self, clock: TimeScale) -> tuple[int, int] | None:
        """Return the time for which trails are drawn, in nanoseconds of the viewer and in steps."""
        if self.trails is None or self.recent is None:
            return None
        return int(clock.nanoseconds([self.recent])[0]), self.trails.steps_of(self.recent)

    @property
    def grid(self) -> str:
        """The side of a square of the grids that show planes, with its unit; empty without such a grid."""
        if self.header.planes is None or not len(self.header.planes) or not self._has_own_grids:
            return ""
        return self.header.units.text(grid_spacing(self._grid_reach), dimension.LENGTH, ".3g")

    @property
    def _has_own_grids(self) -> bool:
        """Whether grids are where the camera looks; the grids of a box or of walls stay as recorded."""
        return self.header.walls is None and self.header.box is None

    @property
    def _grid_reach(self) -> float:
        """Reach (m) of the grids, such that their squares have a round size."""
        least = grid_spacing(0.5 * self.camera.view().height())
        return 0.5 * self.camera.view().height() * _round_length(2.5 * least, self.header.units) / least

    def rows(self) -> Iterator[Rows]:
        """Yield the trails."""
        if self.trails is not None:
            yield from self.trails.rows()

    def statics(self, theme: str = "dark") -> Iterator[Static]:
        """Yield the colours of the trails, and the planes as grids where the camera looks.

        The recorded grids are centred on the initial bodies.
        """
        if self._has_own_grids:
            yield from plane_grids(self.header, self.origin, self.camera.view().target, self._grid_reach, theme)
        if self.trails is not None:
            yield from self.trails.statics()

    def poses(self, view: View, positions: Sequence[FloatArray]) -> list[View]:
        """Return the poses of a camera that moves, for positions (n, 3), in m from the origin, at some times."""
        if view.motion is CameraMotion.FOLLOW:
            return [replace(view, target=view.target + self.camera.offset(each)) for each in positions]
        angles = np.linspace(0.0, 2.0 * np.pi, len(positions))
        return [self.camera.turned_about(view, angle) for angle in angles.tolist()]

    def camera_rows(self, layout: rrb.Blueprint, times: FloatArray, positions: Sequence[FloatArray]) -> Iterator[Rows]:
        """Yield the poses of the cameras that move, for positions (n, 3), in m from the origin, at some times (s)."""
        for shown in views_of(layout.root_container):
            if not isinstance(shown, LensView) or shown.lens.view.motion is CameraMotion.STILL:
                continue
            poses = self.poses(shown.lens.view, positions)
            yield Rows(shown.lens.path, Index(NO_STEPS, times), shown.lens.poses(poses))


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
    """Return the logarithms of the energies with their outlines and styles, if the energies grow by decades."""
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
        statics.append((path, curve_style(each.name_in(header), each.colour, each.width)))
    return outlines, rows, statics


def caption(lines: Sequence[str], theme: str, time: float) -> Iterator[tuple[Rows, Static]]:
    """Yield the title of a plot that fills a picture, which has no title bar: the first lines of its legend.

    Each line is the name of a series without a value, at a time (s) in the plot; its dot has the colour of the ground.
    """
    for line, text in enumerate(lines):
        path = f"{CAPTION}/{line}"
        nothing = Rows(path, Index.within_step(time), list(rr.Scalars.columns(scalars=[np.nan])))
        yield nothing, (path, rr.SeriesLines(names=text, colors=palette.PLOT_GROUNDS[theme]))


def whole_span(recording: Recording) -> Sequence[float]:
    """Return the times (s) of the first and of the last frame."""
    times = recording.fingerprints()["time"].to_numpy()
    return [float(times[0]), float(times[-1])]


def axes_and_field(
    units: UnitSystem,
    view: View,
    area: Area,
    field: FloatArray | None,
    drawn: FloatArray,
    radius: FloatArray,
    legend: tuple[int, int] | None = None,
) -> Iterator[Static]:
    """Draw the axes of space at the lower border of a view, with their length, and a uniform field at the upper border.

    The axes are the scale of the picture: their length is a round number. Each arrow is on the side where it covers
    fewer of the ``drawn`` points, (k, 3) m with radii (k,) m, and on the left if the sides are equal. In a corner with
    a legend, an arrow is beside the legend. The ``field`` is (3,) m/s², or None.
    """
    height, size = view.height(), 0.0 if field is None else float(np.linalg.norm(field))
    right, up = view.axes()
    length = _LENGTH * height
    axis = _round_length(_AXIS * length, units)
    pull = f"gravity, {units.text(size, dimension.ACCELERATION, '.4g')}"
    scale = f"axes: {units.text(axis, dimension.LENGTH, '.6g')}"
    places, sizes = view.on_screen(drawn), view.radius_on_screen(drawn, radius)[:, None]
    # covering one body is worse than covering all points of paths
    weights = np.where(sizes[:, 0] > 0.0, len(sizes) + 1, 1)
    reach = np.array([_LETTER * (len(pull) + 1) / area.height, _LENGTH])  # half sizes of the label and the arrow

    def placed(middle: float, extent: FloatArray, start: float, taken: FloatArray) -> FloatArray:
        aside = np.zeros(2)  # how far the legend moves the axes on each side
        if legend is not None and legend[1] * start > 0.0:
            aside[int(legend[0] > 0)] = -2.0 * legend[1] * area.inset_share[1]
        sides = [np.array([x * 0.72 * area.aspect, middle + down]) for x, down in zip((-1.0, 1.0), aside, strict=True)]
        # in case both sides would cover something: places between the sides, and halfway up
        free = [x for x in (-1.0, 1.0) if legend is None or legend[0] * x < 0.0]
        sides += [np.array([0.0, middle]), *(np.array([x * 0.72 * area.aspect, 0.0]) for x in free)]
        aside = np.pad(aside, (0, len(sides) - 2))
        covered = [weights[np.all(np.abs(places - side) < extent + sizes, axis=1)].sum() for side in sides]
        meets = [bool(np.all(np.abs(taken - side) < extent + 2.0 * _LENGTH, axis=1).any()) for side in sides]
        covered = [count + (weights.sum() + 1) * meet for count, meet in zip(covered, meets, strict=True)]
        first = int(covered[1] < covered[0]) if covered[0] != covered[1] else int(aside[0] != 0.0)
        chosen = first if covered[first] == min(covered) else int(np.argmin(covered))
        place = sides[chosen][0] * right + (sides[chosen][1] - middle + start) * up
        return np.asarray(view.target + 0.5 * height * place)

    corner = placed(-0.72, np.full(2, 1.5 * _LENGTH), -0.72, np.zeros((0, 2)))
    origins, vectors = np.tile(corner, (3, 1)), axis * np.eye(3)
    letters = corner + 1.15 * vectors
    heights = 0.5 * height * (view.on_screen(letters) - view.on_screen(corner))[:, 1]
    row = _ROW * height / area.height  # m, height of a line of text
    beneath = min(-0.45 * _AXIS * length, float(heights.min()) - row)
    if beneath - row < -_BELOW * height:  # Rerun writes a label below its point, beyond the border here
        beneath = float(heights.max()) + row
    texts, ends = ["x", "y", "z", scale], np.vstack([letters, corner + beneath * up])
    theme = area.theme
    colours = palette.legible(_AXES, theme)
    if field is not None:
        top = placed(0.84 - _LENGTH, reach, 0.84, view.on_screen(corner)[None])
        origins, vectors = np.vstack([top, origins]), np.vstack([length * field / size, vectors])
        texts, ends = [pull, *texts], np.vstack([top + 0.5 * vectors[0], ends])
        colours = np.concatenate([palette.legible([palette.FIELD], theme), colours])
    arrows = rr.Arrows3D(
        origins=single(origins), vectors=single(vectors), colors=colours, radii=line_radii(0.05, length)
    )
    yield FIELD, arrows
    ink = palette.INKS[theme]
    labels = rr.Points3D(single(ends), radii=1e-6 * length, labels=texts, colors=ink, show_labels=True)
    yield f"{FIELD}/labels", labels


def _round_length(most: float, units: UnitSystem) -> float:
    """Return the longest round length (m) up to ``most``: 1, 2 or 5 times a power of ten in the scene's unit."""
    shown = units.shown(most, dimension.LENGTH)
    power = 10.0 ** np.floor(np.log10(shown))
    return float(most * max(step for step in (1.0, 2.0, 5.0) if step * power <= shown) * power / shown)


def names_that_fit(header: Header, position: FloatArray, view: View, area: Area) -> tuple[str, ...]:
    """Return the names (n,) of bodies at (n, 3) m if they are few, otherwise ().

    If two names would overlap in a view of this area, the name of the smaller body is empty.
    """
    n = len(position)
    if not any(header.names) or n > MOST_NAMES or n != len(header.names) or shape(header) != "ellipsoids":
        return ()
    numbers = _numbered(header.names)
    whole, short = (_apart(names, header, position, view, area) for names in (header.names, numbers))
    shown, names = (short, numbers) if short.sum() > whole.sum() else (whole, header.names)
    return tuple(name if each else "" for name, each in zip(names, shown.tolist(), strict=True))


def _numbered(names: Sequence[str]) -> list[str]:
    """Return the names; names that differ only by a number at their end, such as "ball 7", become this number."""
    parts = [re.fullmatch(r"(.*\D)(\d+)", name) for name in names]
    stems = Counter(part[1] for part in parts if part is not None)
    usual = stems.most_common(1)[0][0] if stems else ""
    return [part[2] if part is not None and part[1] == usual else name for name, part in zip(names, parts, strict=True)]


def _apart(names: Sequence[str], header: Header, position: FloatArray, view: View, area: Area) -> BoolArray:
    """Return which names (n,) can be shown so that no name covers another; names of large bodies come first."""
    n = len(names)
    points = (position - view.target) @ view.axes().T * area.height / view.height()
    wide = np.array([_LETTER * (len(name) + 1) for name in names])
    across, up = np.abs(points[:, None] - points[None]).transpose(2, 0, 1)
    overlap = (across < (wide[:, None] + wide) / 2.0) & (up < _ROW)
    shown = np.zeros(n, dtype=bool)
    for k in np.argsort(-header.radius, kind="stable"):
        shown[k] = np.isfinite(points[k]).all() and not (overlap[k] & shown).any()
    return shown
