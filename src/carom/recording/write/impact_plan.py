"""Impacts in a recording: their number per frame, their rows, and the positions of the bodies at their times."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple, Protocol

import numpy as np
import rerun as rr

from carom.arrays import FloatArray, IntArray, RecordArray, Records, SingleArray, dtype_of
from carom.physics.jit.decorators import inline, long_kernel
from carom.physics.sheared_box import ShearedBox, nearest_in_drift
from carom.physics.vector import minimum_images
from carom.recording.layout import drawing
from carom.recording.layout.drawing import single
from carom.recording.schema.header import Header
from carom.recording.schema.paths import IMPACT_ENERGY, IMPACTS
from carom.recording.schema.series import IMPULSES, IN_PLOT
from carom.recording.write.encoding_kernels import count_moved
from carom.recording.write.rows import Index, Rows, any_column, plain_column, vector_column
from carom.scene.schema.shear import Shear
from carom.state.checkpoint import Checkpoint
from carom.state.frame import Frame

# Positions of the bodies at impacts between two frames. A body with impacts between the frames touches the contact
# point of each impact, and moves on straight lines in between. Other bodies follow the cubic through their positions
# and velocities in both frames. Orientations are interpolated.


def positions_at(
    times: FloatArray,
    before: Frame | Checkpoint,
    after: Frame,
    impacts: Records,
    radius: FloatArray,
    box: FloatArray,
    shear: Shear | None = None,
) -> FloatArray:
    """Return positions (k, n, 3) m at some times (k,) s between two frames.

    ``impacts`` are all impacts between the frames, `CONTACT_ROW`, in order of time. The periodic box, (3,) m, is zero
    in open space.
    """
    start, dt, images, last = before.position, after.time - before.time, box, after.velocity
    path = minimum_images(after.position - start, shear.cell(box, after.time) if shear else box)
    if shear:  # follow bodies through the faces along the gradient
        (flow, gradient), images = shear.axes, ShearedBox(shear, box).at(before.time)
        last = last.copy()
        last[:, flow] += shear.rate * (start + path - after.position)[:, gradient]
    s = np.clip((times - before.time) / dt, 0.0, 1.0)[:, None, None]
    own, other = before.velocity * dt - path, path - last * dt  # Hermite's cubic, relative to the straight line
    found: FloatArray = start + s * path + s * (1.0 - s) * ((1.0 - s) * own + s * other)
    struck = np.column_stack((impacts["i"], impacts["j"])).ravel()
    order = np.argsort(struck, kind="stable")
    first = np.searchsorted(struck[order], np.arange(len(radius) + 1))
    own_impacts = _ImpactsByBody(impacts, first, order // 2)
    most = int(np.diff(first).max(initial=0)) + 2  # largest number of corners of a path, including both frames
    motion = _Motion(before.time, after.time, start, path, radius, images)
    _pass_through(times, motion, own_impacts, _Corners(np.empty(most), np.empty((most, 3))), found)
    return found


class _Motion(NamedTuple):
    """Motion of the bodies from one frame to the next, along a straight line."""

    begin: float  # s
    end: float  # s
    start: FloatArray  # (n, 3) m
    path: FloatArray  # (n, 3) m, displacement
    radius: FloatArray  # (n,) m
    box: FloatArray  # (3,) m, or the record of a sheared box at the beginning of the interval


class _ImpactsByBody(NamedTuple):
    """The impacts of each body, in order of time: ``rows[own[k]]`` with k in [``first[body]``, ``first[body + 1]``)."""

    rows: Records  # (k,) `CONTACT_ROW`
    first: IntArray  # (n + 1,)
    own: IntArray  # (2 k,)


class _Corners(NamedTuple):
    """Buffer for the corners of the path of one body: both frames, and its impacts between them.

    If `_pass_through` allocated these arrays, its compilation would take a second longer.
    """

    time: FloatArray  # s, times of the corners
    position: FloatArray  # (…, 3) m, corners relative to the start


def orientations_at(times: FloatArray, before: Frame | Checkpoint, after: Frame) -> FloatArray | None:
    """Return orientations (k, n, 4) at some times (k,) s; None if bodies have none."""
    if before.orientation is None or after.orientation is None:
        return None
    s = np.clip((times - before.time) / (after.time - before.time), 0.0, 1.0)[:, None, None]
    sign = np.where(np.sum(before.orientation * after.orientation, axis=1, keepdims=True) < 0.0, -1.0, 1.0)
    turned = (1.0 - s) * before.orientation + s * sign * after.orientation
    return np.asarray(turned / np.linalg.norm(turned, axis=2, keepdims=True))


@long_kernel
def _pass_through(
    times: FloatArray, motion: _Motion, own_impacts: _ImpactsByBody, corners: _Corners, found: FloatArray
) -> None:
    """Move bodies with impacts onto the straight lines from one impact to the next; see `positions_at`."""
    begin, end, start, path, radius, box = motion
    impacts, first, own = own_impacts
    clock, corner = corners
    for body in range(len(radius)):
        lo, last = first[body], first[body + 1] - first[body] + 1  # the corner after the last impact
        if last == 1:
            continue
        clock[0], clock[last] = begin, end
        for k in range(3):
            corner[0, k], corner[last, k] = 0.0, path[body, k]
        for c in range(1, last):
            impact = impacts[own[lo + c - 1]]
            reach = -radius[body] if impact.i == body else radius[body]  # along the normal, which points away from i
            clock[c] = impact.time
            x = impact.x + reach * impact.nx - start[body, 0]
            y = impact.y + reach * impact.ny - start[body, 1]
            z = impact.z + reach * impact.nz - start[body, 2]
            x, y, z = nearest_in_drift(x, y, z, box, impact.time - begin)
            corner[c, 0], corner[c, 1], corner[c, 2] = x, y, z
        for m in range(len(times)):
            time, c = times[m], 0  # the previous corner, as in `numpy.interp`
            while c < last and clock[c + 1] <= time:
                c += 1
            for k in range(3):
                if c == last or time <= clock[c]:
                    found[m, body, k] = start[body, k] + corner[c, k]
                else:
                    speed = (corner[c + 1, k] - corner[c, k]) / (clock[c + 1] - clock[c])
                    found[m, body, k] = start[body, k] + (speed * (time - clock[c]) + corner[c, k])


FILE_BYTES = 300_000  # bytes of layout, styles and footer (docs/recording.md, Size)
# ratio of the bytes of contacts to all other bytes counted here: about a fifth of the whole file, which has further
# data
SHARE = 0.22
_ARROWS, _SCENES = 0.02, 0.04  # largest sizes of arrows and of frames at impacts, as fractions of all other data
_FEW_SCENES = 0.1 * FILE_BYTES  # bytes that frames at impacts may take in any recording
_HARDER = 1.25  # an impact this many times as hard as any with a frame gets a frame even beyond the budget
_SCENE = 850  # bytes of a frame at an impact, in addition to its bodies: edge, arrows, energies, spins
_CONTACT, _IMPACT, _ARROW = 12.5, 85, 36  # measured bytes of each in the file, compressed
_SCALARS = 500  # bytes of a frame's scalars
DRAWN_BYTES, TURNED_BYTES = 12, 28  # bytes of a body in a frame: a centre in float32, and a centre with a quaternion
_AT_REST = 2  # measured bytes of a body that does not move, compressed
# measured bytes of an arrow of torque, of an edge, and of an edge whose bodies move
_TORQUE, _EDGE, _MOVED_EDGE = 25, 5, 12
_CHECKPOINTS = 1.08  # factor by which checkpoints enlarge a frame if arrays that equal others are left out


class BudgetRecord(Protocol):
    """Bytes of a recording so far."""

    others: float  # bytes of everything except contacts and impacts
    contacts: float  # bytes of contacts and impacts
    arrows: float  # bytes of arrows, which are part of `contacts`
    scenes: float  # bytes of frames at impacts, which are part of `contacts`


_BUDGET = dtype_of(BudgetRecord)


class Kept(NamedTuple):
    """Numbers of recorded contacts and impacts in each frame of a batch, (frames,)."""

    impacts: IntArray  # number of impacts since the previous frame, those with the largest normal impulses
    arrows: IntArray  # number of contacts drawn with arrows
    scenes: IntArray  # number of the largest impacts, which get a frame of their own


class _Counts(NamedTuple):
    """Counts for each frame of a batch, (frames,), and the number of all bodies."""

    bodies: int
    moved: IntArray  # number of bodies drawn at other positions than in the previous frame
    edges: IntArray
    contacts: IntArray
    impacts: IntArray


class _BodyColumns(NamedTuple):
    """The data that a frame has for each body besides its position."""

    orientation: bool
    torque: bool


class ImpactPlan:
    """Decides how many impacts and contacts of each frame are recorded.

    All impacts are kept while contacts take at most a fifth of the file. After that, only the largest normal impulses
    are kept, at least one per frame. The choice depends on the frames but not on the batches, so that the same run
    always has the same rows. Frames at the exact times of impacts have a budget, which the first impacts of a crowded
    scene use up. After that, only much harder impacts get a frame: at most ten for each decade of impulses, whatever
    the length of the run.
    """

    def __init__(
        self,
        *,
        everything: bool,  # whether to keep all impacts and draw arrows at all contacts, whatever their size
        oriented: bool,  # whether bodies have orientations
        turned: bool,  # whether bodies have torques
    ) -> None:
        self._everything, self._columns = everything, _BodyColumns(oriented, turned)
        self._budget = np.zeros(1, _BUDGET)
        self._budget["others"] = FILE_BYTES
        self._hardest = 0.0  # N s, largest impulse of an impact with a frame
        self._before: SingleArray | None = None  # (n, 3) m, positions drawn in the previous frame

    @classmethod
    def of(cls, header: Header, *, everything: bool = False) -> ImpactPlan:
        """Return the plan of a recording, which keeps everything if the scene or the caller requests it."""
        everything = everything or header.record_impacts == "all"
        oriented, turned = header.has_orientation, header.has_torque
        return cls(everything=everything, oriented=oriented, turned=turned)

    def choose(
        self, position: FloatArray, edges: IntArray, contacts: IntArray, impacts: IntArray, hardest: FloatArray
    ) -> Kept:
        """Choose the impacts and arrows of the next frames.

        Positions are (frames, n, 3) m. The numbers of edges, contacts and impacts, and the largest normal impulse of an
        impact (N s), are given for each frame, (frames,).
        """
        if self._before is None:
            self._before = np.full(position.shape[1:], np.nan, dtype=np.float32)
        if (new := position.shape[1] - len(self._before)) > 0:  # bodies entered
            self._before = np.concatenate((self._before, np.full((new, 3), np.nan, dtype=np.float32)))
        moved = np.empty(len(position), dtype=np.int64)
        count_moved(position, self._before, moved)
        kept = Kept(*np.empty((3, len(position)), dtype=np.int64))
        counts = _Counts(position.shape[1], moved, edges, contacts, impacts)
        _spend(SHARE, self._everything, self._columns, counts, self._budget, kept)
        for f in np.flatnonzero(hardest > self._hardest).tolist():
            if kept.scenes[f] == 0 and hardest[f] > _HARDER * self._hardest:
                kept.scenes[f] = 1
            if kept.scenes[f]:
                self._hardest = max(self._hardest, float(hardest[f]))
        return kept


def largest(impacts: Records, count: int) -> IntArray:
    """Return the indices of the impacts with the largest normal impulses, by time; ties go to earlier impacts."""
    if len(impacts) <= count:
        return np.arange(len(impacts))
    return np.sort(np.argsort(-impacts["normal_impulse"], kind="stable")[:count])


@long_kernel
def _spend(
    share: float,
    everything: bool,
    columns: _BodyColumns,
    counts: _Counts,
    budget: RecordArray[BudgetRecord],
    kept: Kept,
) -> None:
    """Choose the impacts and arrows of a batch's frames."""
    used, (bodies, moved, edges, contacts, impacts) = budget[0], counts
    scene = _SCENE + bodies * (TURNED_BYTES if columns.orientation else DRAWN_BYTES)
    arrow = 2 * _ARROW if columns.torque else _ARROW  # with friction, a contact has two arrows
    for f in range(len(moved)):
        used.others += _size(bodies, moved[f] / bodies, edges[f], columns)
        most, arrows, room = impacts[f], contacts[f], np.inf
        if not everything:
            used.contacts += _CONTACT * contacts[f]
            most = min(impacts[f], max(1, int((share * used.others - used.contacts) / _IMPACT)))
            used.contacts += _IMPACT * most
            left = min(share * used.others - used.contacts, _ARROWS * used.others - used.arrows)
            arrows = max(0, min(contacts[f], int(left / arrow)))
            used.contacts += arrow * arrows
            used.arrows += arrow * arrows
            room = share * used.others - used.contacts
        own = max(_FEW_SCENES, _SCENES * used.others) - used.scenes
        scenes = max(0, int(min(float(most), min(room, own) / scene)))
        used.contacts += scene * scenes
        used.scenes += scene * scenes
        kept.impacts[f], kept.arrows[f], kept.scenes[f] = most, arrows, scenes


@inline
def _size(bodies: int, moved: float, edges: int, columns: _BodyColumns) -> float:
    """Estimate the bytes of a frame besides contacts: bodies, arrows of torques, edges, scalars, checkpoints.

    Unchanged values compress well; ``moved`` is the fraction of bodies that move.
    """
    drawn = bodies * (_AT_REST + moved * ((TURNED_BYTES if columns.orientation else DRAWN_BYTES) - _AT_REST))
    arrows = _TORQUE * (1 + moved) * min(bodies, 2 * edges) if columns.torque else 0.0
    return _CHECKPOINTS * (drawn + arrows + (_EDGE + _MOVED_EDGE * moved) * edges + _SCALARS)


def impact_rows(
    impacts: Records,
    numbers: IntArray,
    references: Mapping[str, float],
    header: Header,
    origin: FloatArray,
) -> Rows:
    """Return one row for each impact, (k,) `CONTACT_ROW`; ``numbers``, (k,), count the run's impacts from 1.

    ``references`` are the impulse (N s) and the energy (J) in the middle of their scales; ``origin``, (3,) m, is the
    origin of the drawing.
    """
    positions = single(np.stack([impacts["x"], impacts["y"], impacts["z"]], axis=1) - origin)
    friction = np.stack([impacts["friction_x"], impacts["friction_y"], impacts["friction_z"]])
    lost = impacts["restitution_loss"] + impacts["friction_loss"]
    sizes = drawing.point_radii(header.radius)
    radii = sizes[drawing.level(impacts["normal_impulse"], references.get(IMPACTS, 1.0))]
    colours = drawing.COLOURS[drawing.level(lost, references.get(IMPACT_ENERGY, np.inf))]
    bodies = np.stack([impacts["i"], impacts["j"]], axis=1).astype(np.uint32)
    normal = single(np.stack([impacts["nx"], impacts["ny"], impacts["nz"]], axis=1))
    scalars = {
        "approach_speed": impacts["approach_speed"],
        "normal_impulse": impacts["normal_impulse"],
        "tangential_impulse": np.sqrt(np.sum(friction * friction, axis=0)),
        "energy_lost": lost,
    }
    if (factor := header.plot_factor(IMPULSES.unit)) != 1.0:
        scalars[IN_PLOT] = impacts["normal_impulse"] / factor
    columns = [
        vector_column(rr.Points3D.descriptor_positions(), positions),
        plain_column(rr.Points3D.descriptor_radii(), radii),
        plain_column(rr.Points3D.descriptor_colors(), colours),
        any_column("bodies", bodies.ravel(), 2),
        any_column("normal", normal.ravel(), 3),
        *(any_column(name, single(values)) for name, values in scalars.items()),
        any_column("mode", np.ascontiguousarray(impacts["mode"])),
    ]
    steps, times = np.ascontiguousarray(impacts["step"]), np.ascontiguousarray(impacts["time"])
    return Rows(IMPACTS, Index(steps, times, numbers), columns)
