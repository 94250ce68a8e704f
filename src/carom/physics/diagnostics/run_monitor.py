"""Monitors of a run: finite numbers, crossings of a periodic box, activity, pace, and wall time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from time import perf_counter_ns

import numpy as np

from carom.arrays import BoolArray, FloatArray
from carom.errors import PhysicsError
from carom.event import Event
from carom.physics.bodies import Bodies
from carom.physics.jit.decorators import kernel, long_kernel
from carom.physics.jit.team import SOLO, Team
from carom.plan.auto import integrator
from carom.plan.features import require
from carom.scene.load import Scene
from carom.scene.schema.settings import LARGEST_ACCURACY
from carom.scene.units.dimension import TIME
from carom.scene.units.system import SI, UnitSystem
from carom.scene.wording import bodies_called
from carom.state.books import PaceTally
from carom.state.energies import Energy

MOST_CROSSINGS = 1e6
MIN_NUMBERS_PER_TASK = 30_000


def refuse_infinities(
    bodies: Bodies, names: Sequence[str], step: int, time: float, units: UnitSystem, team: Team = SOLO
) -> None:
    """Refuse a state whose positions or velocities are not all finite; PhysicsError names the bodies, step and time."""
    lost = np.zeros(1, dtype=np.bool_)
    numbers = bodies.position.reshape(-1), bodies.velocity.reshape(-1)
    team.divide(len(numbers[0]), MIN_NUMBERS_PER_TASK, _find_infinities, *numbers, lost)
    if not lost[0]:
        return
    finite = np.isfinite(bodies.position) & np.isfinite(bodies.velocity)
    bodies_lost = np.flatnonzero(~finite.all(axis=1))
    raise PhysicsError(
        f"the state is no longer finite at step {step}, t = {units.text(time, TIME)}: position or velocity of "
        f"{bodies_called(bodies_lost.tolist(), names)}"
    )


def refuse_many_crossings(
    velocity: FloatArray, dt: float, box: FloatArray, step: int, time: float, units: UnitSystem
) -> None:
    """Refuse a step of dt (s) in which a body would cross a periodic box more than `MOST_CROSSINGS` times.

    The position in the box loses a digit for each factor of 10 in the number of crossings.
    """
    turns = float((np.abs(velocity).max(axis=0) * dt / box).max())
    if turns > MOST_CROSSINGS:
        when, length = units.text(time, TIME), units.text(dt, TIME, ".3g")
        raise PhysicsError(
            f"at step {step}, t = {when}, a body would cross its periodic box {turns:.3g} times in one step of "
            f"{length}; lower time.fixed_dt or time.max_dt, or the speeds"
        )


@long_kernel
def _find_infinities(lo: int, hi: int, position: FloatArray, velocity: FloatArray, lost: BoolArray) -> None:
    """Set ``lost`` if one of the numbers [lo, hi) is not finite; NumPy would allocate three arrays for this."""
    x, v, infinities = position[lo:hi], velocity[lo:hi], 0
    for k in range(len(x)):  # the loop starts at 0, so that it is vectorised
        infinities += (x[k] - x[k] != 0.0) | (v[k] - v[k] != 0.0)  # ∞ - ∞ is NaN, which does not equal 0
    if infinities > 0:
        lost[0] = True


STEPS_REMEMBERED = 50  # steps over which the energy of impacts is averaged
SETTLED_BELOW = 1e-3  # energy of recent impacts, relative to the energy scale, below which a pile has settled
STILL_BELOW = 1e-4  # kinetic energy, relative to the energy scale, above which bodies roll, slide or fall


class Activity:
    """Follows the contacts of a number of bodies from step to step.

    ``phase`` is "warm-up" before the first step, then "free", "colliding" or "settled". A run has settled if most
    bodies touch, recent impacts were weak and, with ``from_rest``, the kinetic energy is small. Without a uniform field
    or something fixed, a pile at rest may drift and rotate as a whole, so its kinetic energy does not matter.
    """

    def __init__(self, bodies: int, from_rest: bool) -> None:
        self.phase = "warm-up"
        self.impact_energy = 0.0  # J, ½ μ v_n² of recent impacts
        self._bodies = bodies
        self._from_rest = from_rest
        # number of contacts of the last step; None before the first step of a new or resumed run
        self._contacts: int | None = None

    def reopen(self, phase: str, impact_energy: float) -> None:
        """Continue an earlier run."""
        self.phase, self.impact_energy, self._contacts = phase, impact_energy, None

    def add_step(self, contacts: int, impact_energy: float) -> None:
        """Add a step: the number of its contacts, and Σ ½ μ v_n² of its impacts, in J."""
        if impact_energy or self.impact_energy:
            self.impact_energy = remembered(self.impact_energy, impact_energy)
        self._contacts = contacts

    def judge(self, energy: Energy) -> None:
        """Update the phase after the last step, given the energy at its end."""
        if self._contacts is None:
            return
        if self._contacts == 0:
            self.phase = "free"
            return
        quiet = self.impact_energy <= SETTLED_BELOW * energy.scale
        still = not self._from_rest or energy.translational + energy.rotational <= STILL_BELOW * energy.scale
        self.phase = "settled" if quiet and still and 2 * self._contacts >= self._bodies else "colliding"


@kernel
def remembered(energy: float, impacts: float) -> float:
    """Return the energy (J) of recent impacts after a step, given the earlier energy and the energy of new impacts."""
    return energy + (impacts - energy / STEPS_REMEMBERED)


CRAWL = 5.0  # a run crawls if it takes this many times as many steps as its first step predicts
MIN_STEPS = 50_000  # runs with fewer steps end before a warning is useful

REMEDY = {  # the key that allows longer steps, by the limit that shortens them
    "acceleration": "time.target_dx",
    "held": "time.target_dx, to more than 1 % of the smallest radius",  # 1 % is the automatic value for held bodies
    "velocity": "time.cfl",
    "pull": "time.pull_fraction",
    "cap": "time.max_dt",
    "fixed": "time.fixed_dt",
}


def remedies_of(scene: Scene) -> Mapping[str, str]:
    """Return, for each limit of the step, the scene key that gives fewer steps if it is raised.

    An accuracy replaces the keys that set the step. Without forces, steps with an accuracy already have their longest
    useful length. Integrators that choose steps by their error use time.max_dt directly. If contacts are possible, no
    key is named, since leapfrog, which computes resting contacts for these integrators, also uses time.max_dt.
    """
    accuracy = scene.time.accuracy
    if accuracy is None:
        return REMEDY
    if integrator(scene).controls_error:
        return {} if require(scene).contact.modelled else {"cap": REMEDY["cap"]}
    return dict.fromkeys(REMEDY, "time.accuracy") if require(scene).accelerates and accuracy < LARGEST_ACCURACY else {}


class PaceMonitor:
    """Checks the step from time to time, and warns once if the run slows down; ``remedies`` come from `remedies_of`."""

    def __init__(
        self, duration: float, first_dt: float, units: UnitSystem = SI, remedies: Mapping[str, str] = REMEDY
    ) -> None:
        self._units, self._remedies = units, remedies
        self._duration = duration
        self._first_dt = first_dt
        self.tally = PaceTally()

    def check(self, step: int, time: float, dt: float, limit: str) -> Event | None:
        """Check the next step, of dt seconds, and the limit that sets it; return the warning at most once.

        The monitor warns if the run would take too many steps both at the mean pace so far and at the pace of the next
        step.
        """
        short = CRAWL * dt < self._first_dt
        since = self.tally.slow_since if self.tally.slow_since is not None else time
        self.tally = PaceTally(since if short else None, self.tally.told)
        promised = self._duration / self._first_dt
        whole = min(step * self._duration / time, step + max(0.0, self._duration - time) / dt)
        if not short or self.tally.told or whole < max(MIN_STEPS, CRAWL * promised):
            return None
        self.tally = PaceTally(since, told=True)
        raised = self._remedies.get(limit)
        remedy = f" To shorten the run, raise {raised}." if raised else ""
        text = (
            f"The step is set by the limit {limit} and has been {self._first_dt / dt:.3g} times shorter than the "
            f"first step since t = {self._units.text(since, TIME)}: at this pace the run takes {whole:.3g} steps, "
            f"{whole / promised:.3g} times the estimate at its start.{remedy}"
        )
        return Event(step, time, "WARN", text, "pace")


class Profile:
    """Sums wall time by part of the step. Each mark costs one reading of the clock."""

    def __init__(self) -> None:
        self._nanoseconds: dict[str, int] = {}
        self._last = 0

    def start(self) -> None:
        """Begin a step."""
        self._last = perf_counter_ns()

    def mark(self, part: str) -> None:
        """Add the time since the last mark to a part."""
        now = perf_counter_ns()
        self._nanoseconds[part] = self._nanoseconds.get(part, 0) + now - self._last
        self._last = now

    def clear(self) -> None:
        """Discard all times so far, for example the time of the warm-up, which compiles kernels."""
        self._nanoseconds.clear()

    def seconds(self) -> dict[str, float]:
        """Return the seconds spent in each part, in the order of the step."""
        return {part: spent * 1e-9 for part, spent in self._nanoseconds.items()}
