"""Fields on a grid: solid fraction, velocity, granular temperature, stress and coordination, averaged over an interval.

The equations are in docs/physics.md, section 13.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from carom.arrays import BoolArray, FloatArray
from carom.errors import RecordingError
from carom.lab.fields.coarse_graining import BodySums, Branches, Grid, add_transferred
from carom.lab.fields.field_arrays import Fields
from carom.lab.fields.field_files import refuse, write
from carom.lab.fields.sources import Pushes, collect
from carom.lab.statistics import Interval, Watcher
from carom.recording.read.lookup import check_times
from carom.recording.read.recording import Recording
from carom.scene.portable_math import ENDLESS
from carom.scene.units.dimension import LENGTH, UnitError, nearest_float, quantity
from carom.scene.wording import counted

CELL = "5r"  # default edge of a cell, in mean radii
MOST_CELLS = 2_000_000  # each cell has 30 numbers: 0.5 GB in all
_RADII = re.compile(r"\s*([0-9]*\.?[0-9]+(?:[eE][-+]?[0-9]{1,3})?)\s*r\s*")
_OVERLAP = 0.1  # largest overlap with a wall, in radii, for which no layer of cells beyond the wall is added


def fields(
    recording: Recording | str | Path,
    cell: str | float = CELL,
    start: float | None = None,
    end: float | None = None,
    *,
    replay: bool = False,
    output: str | Path | None = None,
    force: bool = False,
    watch: Watcher = lambda status: None,
) -> Fields:
    """Average the bodies and contacts of a recording in the cells of a grid, over an interval.

    Nothing is simulated unless ``replay`` is given: bodies and lasting contacts come from at most 64 exact states, and
    impacts without a row in the recording do not count. The result's attribute ``notes`` names what is missing.

    Parameters
    ----------
    recording
        The recording, or its file.
    cell
        The edge of a cell: a number in the units of the scene, a text such as "3 cm", or "5r", which is 5 mean radii
        of the moving bodies. Along periodic axes and between walls, the nearest length that divides the box is used.
    start, end
        First and last time in s; by default the whole recording.
    replay
        Whether to compute the steps again, for all impacts, all friction and up to 64 frames.
    output
        A file to write: .vti for ParaView, .npz for NumPy, or a picture, .png or .svg.
    force
        Whether an existing file may be replaced.
    watch
        Called after every frame of the replay.

    Raises
    ------
    RecordingError
        If the cell is not a length, the grid would have too many cells, no body moves, the interval has no exact
        state, or the file cannot be written.
    """
    if output is not None:
        refuse(Path(output), force)
    opened = recording if isinstance(recording, Recording) else Recording.open(recording)
    check_times(start=start, end=end)
    interval = Interval.of(opened, start, end, replay, watch)
    if not interval.moving.any():
        raise RecordingError(f"{opened.path}: all bodies are fixed, so there are no fields")
    grid = grid_of(interval, edge_of(interval, cell))
    sums = FieldSums(interval, grid)
    collect(interval, sums)
    found = sums.fields()
    if output is not None:
        write(found, Path(output))
    return found


def edge_of(interval: Interval, cell: str | float) -> float:
    """Return the edge of a cell in m; RecordingError if it is not a length above 0."""
    units, text = interval.recording.units, str(cell)
    try:
        if matched := _RADII.fullmatch(text):
            edge = float(matched[1]) * float(interval.recording.bodies.radius[interval.moving].mean())
        else:
            try:
                edge = units.converted(float(text), LENGTH)
            except ValueError:
                edge = units.of_si(nearest_float(quantity(text, LENGTH)), LENGTH)
    except UnitError:
        edge = np.nan
    with np.errstate(over="ignore"):
        volume = np.prod(np.full(3, edge))
    if not (edge > 0.0 and 0.0 < volume < np.inf):
        raise RecordingError(
            f'cell {text}: expected a length above 0, such as 0.1 or "3 cm", or a number of mean radii, such as {CELL}'
        )
    return edge


def grid_of(interval: Interval, edge: float) -> Grid:
    """Return the grid with the given edge of a cell (m) that contains all bodies in the frames of an interval."""
    scene, recording = interval.scene, interval.recording
    box = np.full(3, ENDLESS) if interval.box is None else interval.box
    periodic = box < ENDLESS
    if scene is not None and scene.domain.size is not None:
        box = np.where([axis == "walls" for axis in scene.domain.axes], scene.domain.size, box)
    low, high = np.full((2, 3), np.nan)
    if np.any(box >= ENDLESS):
        radius = (1.0 - _OVERLAP) * recording.bodies.radius[interval.moving, None]
        for step in interval.step.tolist():
            position = interval.positions.drawn(step)[interval.moving]
            low = np.fmin(low, np.fmin.reduce(position - radius))
            high = np.fmax(high, np.fmax.reduce(position + radius))
    cells, origin, shape = np.full(3, edge), np.zeros(3), np.ones(3)
    for axis in range(3):
        if box[axis] < ENDLESS:
            shape[axis] = max(1.0, np.round(box[axis] / edge))
            cells[axis], origin[axis] = box[axis] / shape[axis], -box[axis] / 2.0
        else:
            first, last = np.floor(low[axis] / edge), np.ceil(high[axis] / edge)
            origin[axis], shape[axis] = first * edge, max(1.0, last - first)
    if not np.prod(shape) <= MOST_CELLS:
        raise RecordingError(
            f"{recording.path}: the grid would have {' × '.join(f'{n:.4g}' for n in shape)} cells of "
            f"{recording.units.text(edge, LENGTH)}, and at most {MOST_CELLS} fit; choose larger cells, or an interval "
            "in which the bodies are closer together"
        )
    x, y, z = (int(n) for n in shape)
    return Grid(origin, cells, (x, y, z), (bool(periodic[0]), bool(periodic[1]), bool(periodic[2])), recording.shear)


class FieldSums:
    """Sums over the bodies and contacts of an interval; see `sources.Collector`."""

    def __init__(self, interval: Interval, grid: Grid) -> None:
        self._interval, self._grid = interval, grid
        self._bodies = BodySums(grid)
        self._cell_of = np.zeros(interval.bodies, np.int64)  # cell of each body at the last moment
        self._lasting = np.zeros((grid.count, 3, 3))  # J s, Σ ℓ ⊗ J over the steps
        self._impacts = np.zeros((grid.count, 3, 3))
        self._elapsed = 0.0  # s, total length of the steps with lasting contacts
        self._knows_contacts = False

    def add_bodies(self, position: FloatArray, velocity: FloatArray, there: BoolArray, time: float) -> None:
        """Add bodies at a time (s): positions (m), velocities (m/s), both (n, 3), and a mask of existing ones, (n,)."""
        kept, bodies = self._interval.moving & there, self._interval.recording.bodies
        self._cell_of[:] = -1
        self._cell_of[kept] = self._bodies.add(
            position[kept], velocity[kept], bodies.mass[kept], bodies.radius[kept], time
        )

    def add_contacts(self, pushes: Pushes, elapsed: float) -> None:
        """Add the lasting contacts of a step, whose impulses balance constant forces over a time (s)."""
        self._knows_contacts = True
        self._elapsed += elapsed
        add_transferred(self._lasting, self._grid, self._branches(pushes))
        ends = np.concatenate([pushes.i, pushes.j[pushes.j < self._interval.bodies]])
        cell = self._cell_of[ends]
        self._bodies.contacts += np.bincount(cell[cell >= 0], minlength=self._grid.count)

    def add_impacts(self, pushes: Pushes) -> None:
        """Add impacts."""
        add_transferred(self._impacts, self._grid, self._branches(pushes))

    def add_unplaced(self, virial: FloatArray, of: FloatArray) -> None:
        """Add Σ ℓ ⊗ J (J) of impacts with unknown places, given the sum over impacts with known places, (3, 3) each.

        Each cell receives the fraction that it has of the trace over impacts with known places, without parts inside
        fixed bodies.
        """
        share = np.trace(self._impacts, axis1=1, axis2=2)
        if np.trace(of) > 0.0:
            self._impacts += (share / np.trace(of))[:, None, None] * virial

    def _branches(self, pushes: Pushes) -> Branches:
        radius, n, moving = self._interval.recording.bodies.radius, self._interval.bodies, self._interval.moving
        pair = pushes.j < n
        j = np.where(pair, pushes.j, 0)
        share = radius[pushes.i] / (radius[pushes.i] + np.where(pair, radius[j], 0.0))
        return Branches.of(
            pushes.start, pushes.whole, pushes.impulse, pushes.time, share, (moving[pushes.i], pair & moving[j])
        )

    def fields(self) -> Fields:
        """Divide the sums by the volume of a cell, and by the number of moments or the length of the interval."""
        interval, grid, sums = self._interval, self._grid, self._bodies
        recording, each = interval.recording, 1.0 / (sums.moments * grid.volume)
        collides = bool(recording.info["collides"])
        known = self._knows_contacts or not collides
        contact = np.zeros((grid.count, 3, 3)) if known else np.full((grid.count, 3, 3), np.nan)
        if self._elapsed > 0.0:
            contact += self._lasting / (self._elapsed * grid.volume)
        if interval.duration > 0.0:
            contact += self._impacts / (interval.duration * grid.volume)
        with np.errstate(invalid="ignore"):  # cells without bodies
            velocity = sums.momentum / sums.mass[:, None]
            temperature = np.trace(sums.kinetic, axis1=1, axis2=2) / (3.0 * sums.number)
            coordination = sums.contacts / sums.number if known else np.full(grid.count, np.nan)
        shape = grid.shape
        return Fields(
            title=recording.title,
            units=recording.units,
            start=float(interval.time[0]),
            end=float(interval.time[-1]),
            moments=sums.moments,
            bodies=int(np.count_nonzero(interval.moving)),
            origin=grid.origin,
            cell=grid.cell,
            number_density=(sums.number * each).reshape(shape),
            solid_fraction=(sums.volume * each).reshape(shape),
            density=(sums.mass * each).reshape(shape),
            velocity=velocity.reshape(*shape, 3),
            granular_temperature=temperature.reshape(shape),
            kinetic_stress=(sums.kinetic * each).reshape(*shape, 3, 3),
            contact_stress=contact.reshape(*shape, 3, 3),
            coordination=coordination.reshape(shape),
            notes=self._notes(known),
        )

    def _notes(self, known: bool) -> list[str]:
        """Describe the data that are missing."""
        interval, recording, notes = self._interval, self._interval.recording, list[str]()
        largest = float(recording.bodies.radius[interval.moving].max())
        if self._grid.cell.min() < 2.0 * largest:
            notes.append(
                "cells are smaller than the largest body, whose whole volume is in the cell of its centre: the solid "
                "fraction of single cells may be above 1"
            )
        remedy = "" if recording.engine else "; compute them with --replay"
        if not known:
            notes.append(f"the recording has no contacts, so contact stress and coordination are missing{remedy}")
            return notes
        if interval.replay or recording.engine or not recording.info["collides"]:
            return notes
        if interval.duration == 0.0:
            notes.append("the interval is one frame, so the stress has no impacts, which are counted between frames")
        elif left_out := _left_out(interval):
            notes.append(left_out)
        if recording.info["has_friction"] and self._impacts.any():
            notes.append(
                "the friction of single impacts is not recorded; their sum is placed where impacts are, and does not "
                "change the pressure"
            )
        return notes


def _left_out(interval: Interval) -> str:
    """State the number of impacts without rows, and their contribution; empty if all impacts have rows."""
    try:
        rows, left_out = interval.impacts, interval.impacts_left_out
    except RecordingError:
        return ""
    if not left_out:
        return ""
    smaller = f"{counted(left_out, 'smaller impact')} of {left_out + len(rows.step)}"
    try:
        whole = float(np.trace(interval.sums.virial))
    except RecordingError:
        return f"{smaller} have no rows and are missing in the stress; --replay has them"
    part = 1.0 - float((interval.arms(rows.i, rows.j) * rows.impulse).sum()) / whole
    return (
        f"{smaller} have no rows; they contribute {100.0 * part:.2g} % of the pressure of all impacts, which is "
        "distributed over the places of the impacts with rows; --replay finds the place of each"
    )
