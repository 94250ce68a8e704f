"""Orbital elements: positions and velocities of bodies on Kepler orbits about a central mass at the origin.

With the pericentre distance q, the eccentricity e and the time t since the pericentre, the universal anomaly χ solves
Kepler's equation for ellipses, parabolas and hyperbolas (Danby, *Fundamentals of Celestial Mechanics*, §6.9),

    √μ t = q χ + e χ³ c₃(z),   z = χ² (1 - e) / q,

and in the orbital plane, with x towards the pericentre,

    x = q - χ² c₂,           ẋ = -√μ χ c₁ / r,                r = q + e χ² c₂,
    y = √(q (1 + e)) χ c₁,   ẏ = √(μ q (1 + e)) c₀ / r,       μ = G (M + m),

where c₀(z) … c₃(z) are Stumpff's functions.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from carom.arrays import FloatArray, IntArray
from carom.errors import SceneError
from carom.scene.data import DataTable, Raw, numbers_of
from carom.scene.data.facts import ECLIPTIC, SUN, Facts, column_factor, columns_of
from carom.scene.data.mapping import ELEMENTS, ORIENTED, elements_in
from carom.scene.portable_math import cosine_and_sine, cube_root
from carom.scene.schema.body import KeplerianOrbits
from carom.scene.units.dimension import ANGLE, LENGTH, MASS, TIME, VELOCITY, Dimension, size_of
from carom.scene.units.system import UnitSystem

_ANGLES = ("i", "node", "peri", "M")
_TURNING = ("i", "node", "peri")  # angles that every program writes within one turn
_DEGREE = math.pi / 180.0
_TURN = 2.0 * math.pi * (1.0 + 1e-9)  # radians in a turn, with an allowance for printed digits
_OF_JPL = {"full_name", "pdes", "spkid"}  # columns that identify a table of JPL's small bodies
_UNITS_OF_JPL = {
    **{"a": "au", "q": "au", "tp": "day", "epoch": "day", "diameter": "km"},
    **dict.fromkeys(("i", "om", "w", "ma"), "deg"),
}
_IN_DEGREES = {"i", "om", "w", "ma"}  # JPL's names of angles, which it writes in degrees
_JULIAN = (2.2e6, 2.7e6)  # Julian dates of the years 1311 to 2680; an epoch outside of this range is not a Julian date
_TERMS = 9  # terms in the series of Stumpff's functions; the next term is less than 1e-18
# largest number of steps of Newton's method: an ellipse takes some 6, a hyperbola one per unit of the anomaly
_MOST_STEPS = 1000


class Centre(NamedTuple):
    """The central body of orbits, in units of the simulation."""

    constant: float  # gravitational constant
    mass: float
    name: str = ""  # name of the [[body]]; empty for a mass at rest at the origin
    position: tuple[float, ...] = (0.0, 0.0, 0.0)
    velocity: tuple[float, ...] = (0.0, 0.0, 0.0)


class OrbitTable(DataTable):
    """A table of orbital elements as a table of positions and velocities.

    Raises SceneError, which names the missing elements, or the first row that is not an orbit.
    """

    position, velocity = "position on the orbit", "velocity on the orbit"
    own = (position, velocity)

    def __init__(self, table: DataTable, orbit: KeplerianOrbits, centre: Centre, units: UnitSystem) -> None:
        self.called, self.hidden, self.facts, self.paths = table.called, table.hidden, table.facts, table.paths
        self.vectors, self.timed, self.law = table.vectors, table.timed, table.law
        self._table, self._units, self._orbit, self._centre = table, units, orbit, centre
        if centre.constant * centre.mass <= 0.0:
            raise SceneError(f"{self.called}: orbits need gravity.constant above 0")
        is_of_jpl = bool(_OF_JPL & set(table.names))
        if is_of_jpl:
            self.facts = replace(table.facts, of_columns=_UNITS_OF_JPL, frame=ECLIPTIC, centre=SUN)
        # for an unnamed object, the designation serves as a name
        names = [name for name in table.names if name != "name" or "full_name" not in table.names]
        self._columns = elements_in(columns_of(names, self.facts, self.paths))
        # this refuses a table that lacks an element
        there = self._columns
        missing = [f"{element} ({ELEMENTS[element][0]})" for element in ORIENTED if element not in there]
        missing += [] if {"a", "q"} & set(there) else ["a or q"]
        missing += [] if {"M", "tp"} & set(there) else ["M (ma) or tp"]
        if missing:
            raise SceneError(
                f"{self.called}: orbit needs the columns a or q, e, i, om, w, and ma or tp; there is no "
                f"{', no '.join(missing)}"
            )
        if "tp" in there and "M" not in there and orbit.epoch is None and "epoch" not in there:
            raise SceneError(f"{self.called}: tp needs an epoch: a column, or orbit.epoch in the same unit")
        used = {column.name for column in there.values()}
        self.names = [*self.own, *(name for name in names if name not in used)]
        mass = units.text(centre.mass, MASS)
        where = centre.name or "at rest at the origin"
        source = "small bodies of JPL" if is_of_jpl else "orbital elements"
        listed = ", ".join(column.shown for column in there.values())
        self._angle = angle = self._unit_of_angles()
        self.notes = (
            *table.notes,
            f"{self.called}: read as {source} ({listed}){f', angles in {angle}' if angle else ''}, about {mass} "
            f"({where}), with μ = G (M + m)",
        )

    def read(self, names: Sequence[str], texts: Sequence[str] = ()) -> dict[str, Raw]:
        """Read columns other than the elements."""
        return self._table.read(names, texts)

    @property
    def rows(self) -> int:
        """Number of rows of the file."""
        return len(self._raw[self._columns["e"].name])

    def stated(self) -> Facts:
        """Return the file's statements, with the epoch of the bodies if it is a Julian date."""
        own = self._orbit.epoch
        if own is None and "epoch" in self._columns:
            own = float(numbers_of(self.called, "epoch", self._raw[self._columns["epoch"].name])[0])
        return self.facts if own is None or not _JULIAN[0] < own < _JULIAN[1] else replace(self.facts, epoch=own)

    @cached_property
    def _raw(self) -> dict[str, Raw]:
        """The columns of all elements. All are read at once, because each read parses a whole text file."""
        return self._table.read([column.name for column in self._columns.values()])

    def _unit_of_angles(self) -> str:
        """Return the unit of angles whose columns name no unit; empty if there are no such angles.

        The unit comes from ``orbit.angle``, from the file, or from the scene; otherwise it is the degree. Raises
        SceneError if the values suggest the other unit.
        """
        unnamed = [element for element in _ANGLES if element in self._columns and not self._columns[element].unit]
        if not unnamed:
            return ""
        if self._orbit.angle is not None:
            return self._orbit.angle
        if self.facts.states(ANGLE):
            return self.facts.units.given["angle"]
        largest = {element: float(np.abs(self._numbers(element)).max(initial=0.0)) for element in unnamed}
        asked = ", ".join(self._columns[element].name for element in unnamed)
        remedy = 'write orbit = { …, angle = "rad" } or angle = "deg" in [[bodies]]'
        if text := self._units.given.get("angle", ""):
            in_radians = size_of(text, ANGLE) == 1
            if in_radians and any(largest.get(element, 0.0) > _TURN for element in _TURNING):
                raise SceneError(
                    f'{self.called}: [units] angle = "{text}", but {asked} are up to {max(largest.values()):g}, which '
                    f"suggests degrees; {remedy}"
                )
            return text
        of_jpl = {self._columns[element].proper for element in unnamed} <= _IN_DEGREES
        if 0.0 < max(largest.values()) <= _TURN and not of_jpl:
            raise SceneError(
                f"{self.called}: {asked} are all within ±2π, which suggests radians (REBOUND's), but no unit is "
                f"stated; {remedy}"
            )
        return "deg"

    def _numbers(self, element: str) -> FloatArray:
        """Return an element of all rows, in the unit of its column."""
        column = self._columns[element].name
        values = numbers_of(self.called, column, self._raw[column])
        if values.ndim != 1 or not np.isfinite(values).all():
            row = int(np.argmax(~np.isfinite(values)))
            raise SceneError(f"{self.called}: column {column}, row {row}: {values[row]:g} is not a finite number")
        return values

    def _element(self, element: str) -> FloatArray:
        """Return an element of the selected bodies: angles in degrees, times in the unit of their column."""
        values, column = self._numbers(element)[self._kept], self._columns[element]
        if element in _ANGLES:
            text = column.unit or self._angle
            return values if text == "deg" else values * float(size_of(text, ANGLE) / size_of("deg", ANGLE))
        return values * self._factor(element, LENGTH) if element in ("a", "q") else values

    def _factor(self, element: str, dimension: Dimension) -> float:
        """Return the size of an element's unit in units of the simulation."""
        return column_factor(self.called, self._columns[element], self.facts, element, (dimension,), self._units)

    def states(self, mass: FloatArray, kept: IntArray) -> tuple[FloatArray, FloatArray]:
        """Return positions and velocities (n, 3) at the epoch for selected rows, given the masses (n,)."""
        self._kept = kept
        e = self._element("e")
        beta, q = self._shape(e)
        # √μ t since the pericentre; for an ellipse, since the nearest pericentre
        ellipse, root_mu = beta > 0.0, np.sqrt(self._centre.constant * (self._centre.mass + mass))
        rate = np.abs(beta) * np.sqrt(np.abs(beta))  # rate of the mean anomaly with respect to √μ t
        elapsed = self._elapsed(len(e)) * root_mu
        with np.errstate(divide="ignore", invalid="ignore"):
            if "M" in self._columns:
                mean = self._element("M")
                if (parabola := beta == 0.0).any():
                    row = int(np.argmax(parabola))
                    raise SceneError(f"{self.called}: row {kept[row]}: a parabola has no mean anomaly; give q and tp")
                turns = np.fmod(mean, 360.0) / 360.0 + elapsed * rate / (2.0 * math.pi)
                open_time = mean * _DEGREE / rate + elapsed
            else:
                turns, open_time = elapsed * rate / (2.0 * math.pi), elapsed
            time = np.where(ellipse, (turns - np.rint(turns)) * (2.0 * math.pi) / rate, open_time)
        x, y, vx, vy = _plane_of_orbit(q, e, beta, time)
        (cos_i, sin_i), (cos_node, sin_node), (cos_peri, sin_peri) = (
            cosine_and_sine(self._element(element)) for element in ("i", "node", "peri")
        )
        towards = np.stack(  # direction of the pericentre
            (
                cos_node * cos_peri - sin_node * sin_peri * cos_i,
                sin_node * cos_peri + cos_node * sin_peri * cos_i,
                sin_peri * sin_i,
            ),
            axis=1,
        )
        across = np.stack(
            (
                -cos_node * sin_peri - sin_node * cos_peri * cos_i,
                -sin_node * sin_peri + cos_node * cos_peri * cos_i,
                cos_peri * sin_i,
            ),
            axis=1,
        )
        position = x[:, None] * towards + y[:, None] * across
        velocity = root_mu[:, None] * (vx[:, None] * towards + vy[:, None] * across)
        self.advice = self._advice(mass, position, velocity)
        return position + np.array(self._centre.position), velocity + np.array(self._centre.velocity)

    def _advice(self, mass: FloatArray, position: FloatArray, velocity: FloatArray) -> tuple[str, ...]:
        """Return a note on how a central body must move so that the common barycentre rests at the origin."""
        total = self._centre.mass + math.fsum(mass.tolist())
        if not self._centre.name or not mass.any():
            return ()
        own = self._units
        x, v = (-(mass[:, None] * each).sum(axis=0) / total for each in (position, velocity))
        x, v = ([own.shown(float(each), kind) for each in row] for row, kind in ((x, LENGTH), (v, VELOCITY)))
        return (
            f"{self.called}: the barycentre of {self._centre.name} and these bodies rests at the origin if "
            f"{self._centre.name} has position = {x} and velocity = {v}",
        )

    def _shape(self, e: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return 1/a, which is 0 for a parabola, and the pericentre distance."""
        if "q" in self._columns:
            q = self._element("q")
            with np.errstate(divide="ignore", invalid="ignore"):
                beta = (1.0 - e) / q
            wrong, key, size = ~(q > 0.0) | (e < 0.0), "q", q
        else:
            size = self._element("a")
            with np.errstate(divide="ignore"):
                beta, q = 1.0 / size, size * (1.0 - e)
            wrong, key = ~(q > 0.0) | (e < 0.0), "a"
        if wrong.any():
            row = int(np.argmax(wrong))
            raise SceneError(
                f"{self.called}: row {self._kept[row]}: {key} = {size[row] / self._factor(key, LENGTH):g} and "
                f"e = {e[row]:g} define no orbit; an ellipse has 0 ≤ e < 1 and a > 0, a hyperbola e > 1 and a < 0, and "
                "q is above 0"
            )
        return beta, q

    def _elapsed(self, bodies: int) -> FloatArray:
        """Return the time from the epoch of the mean anomaly, or from the pericentre, to the epoch of the scene."""
        own = self._element("epoch") if "epoch" in self._columns else None
        if self._orbit.epoch is None and own is not None and np.any(own != own[:1]):
            raise SceneError(
                f"{self.called}: its epochs differ, from {own.min():.10g} to {own.max():.10g}; give orbit.epoch in the "
                "same unit"
            )
        if "M" in self._columns:
            if self._orbit.epoch is None:
                return np.zeros(bodies)
            if own is None:
                raise SceneError(
                    f"{self.called}: orbit.epoch needs the epoch of the mean anomalies; add a column named epoch"
                )
            return (self._orbit.epoch - own) * self._factor("epoch", TIME)
        start = np.full(bodies, self._orbit.epoch) if own is None or self._orbit.epoch is not None else own
        return (start - self._element("tp")) * self._factor("tp", TIME)


def _plane_of_orbit(q: FloatArray, e: FloatArray, beta: FloatArray, time: FloatArray) -> tuple[FloatArray, ...]:
    """Return x, y and their rates divided by √μ, at a time since the pericentre in units of 1/√μ."""
    wanted, closed = np.abs(time), beta > 0.0
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        # Newton's method descends from above, since r grows with χ: it starts at the apocentre, or at the smaller of
        # two upper bounds
        furthest = np.where(closed, math.pi / np.sqrt(np.abs(beta)), cube_root(6.0 * wanted / np.maximum(e, 1.0)))
        chi = np.minimum(wanted / q, furthest)
    for _ in range(_MOST_STEPS):
        _, _, c2, c3 = _stumpff(beta * chi * chi)
        excess = chi * (q + e * chi * chi * c3) - wanted
        lower = np.maximum(np.minimum(chi, chi - excess / (q + e * chi * chi * c2)), 0.0)
        if np.array_equal(lower, chi):
            break
        chi = lower
    chi = np.copysign(chi, time)
    c0, c1, c2, _ = _stumpff(beta * chi * chi)
    r, side = q + e * chi * chi * c2, np.sqrt(q * (1.0 + e))
    return q - chi * chi * c2, side * chi * c1, -chi * c1 / r, side * c0 / r


def _stumpff(z: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return Stumpff's functions c₀ to c₃: by series at z / 4ᵏ, whose size is below 1, and then by k doublings."""
    _, exponent = np.frexp(np.abs(z))
    halvings = np.maximum(0, (exponent + 1) // 2)
    small = np.ldexp(z, -2 * halvings)
    c2, c3 = np.zeros_like(z), np.zeros_like(z)
    for k in range(_TERMS, -1, -1):
        c2 = 1.0 / math.factorial(2 * k + 2) - small * c2
        c3 = 1.0 / math.factorial(2 * k + 3) - small * c3
    c0, c1 = 1.0 - small * c2, 1.0 - small * c3
    for k in range(int(halvings.max(initial=0))):
        more = halvings > k
        c3 = np.where(more, (c2 + c0 * c3) / 4.0, c3)
        c2 = np.where(more, c1 * c1 / 2.0, c2)
        c0, c1 = np.where(more, 2.0 * c0 * c0 - 1.0, c0), np.where(more, c0 * c1, c1)
    return c0, c1, c2, c3
