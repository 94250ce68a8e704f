"""A warning when short steps make a run take many times as many as its start promised."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from carom.event import Event
from carom.plan.auto import integrator
from carom.plan.features import require
from carom.scene.schema import Scene
from carom.scene.schema.settings import LARGEST_ACCURACY
from carom.scene.units.dimension import TIME
from carom.scene.units.system import SI, UnitSystem

CRAWL = 5.0  # times as many steps as the first one promised
MIN_STEPS = 50_000  # a shorter run ends before a warning is of use

REMEDY = {  # the key that makes steps longer, by the limit that sets them
    "acceleration": "time.target_dx",
    "held": "time.target_dx",
    "velocity": "time.cfl",
    "pull": "time.pull_fraction",
    "cap": "time.max_dt",
    "fixed": "time.fixed_dt",
}


def remedies_of(scene: Scene) -> Mapping[str, str]:
    """Return the key of a scene to raise for fewer steps, by the limit that sets them; none where no key would help.

    An accuracy takes the place of the keys that set the step. Where nothing pulls, its steps are the longest useful
    ones. Integrators that choose steps by their error take time.max_dt as it is. The leapfrog that takes over where
    contacts come to rest takes a part of it.
    """
    accuracy = scene.time.accuracy
    if accuracy is None:
        return REMEDY
    if integrator(scene).controls_error:
        return {} if require(scene).contact.modelled else {"cap": REMEDY["cap"]}
    return dict.fromkeys(REMEDY, "time.accuracy") if require(scene).pulls and accuracy < LARGEST_ACCURACY else {}


@dataclass(frozen=True, slots=True)
class PaceTally:
    """The state of the monitor between two checks."""

    slow_since: float | None = None  # s, since when all checked steps were short; None if the last one was not
    told: bool = False  # whether the warning was given


class PaceMonitor:
    """Checks the step from time to time, and warns once if the run slows down.

    Parameters
    ----------
    duration
        s, of the scene.
    first_dt
        s, the step at its start.
    units
        Of the scene.
    remedies
        As from `remedies_of`.
    """

    def __init__(
        self, duration: float, first_dt: float, units: UnitSystem = SI, remedies: Mapping[str, str] = REMEDY
    ) -> None:
        self._units, self._remedies = units, remedies
        self._duration = duration
        self._first_dt = first_dt
        self.tally = PaceTally()

    def look(self, step: int, time: float, dt: float, limit: str) -> Event | None:
        """Check the next step, of dt seconds, and the limit that sets it; return a warning at most once.

        It warns if the run would take too many steps at the pace so far, and also at the pace of the next step.
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
            f"The step is set by the limit {limit}, and {self._first_dt / dt:.3g} times shorter than the first, "
            f"since t = {self._units.text(since, TIME)}: at this pace the run takes {whole:.3g} steps, "
            f"{whole / promised:.3g} times as many as its start promised.{remedy}"
        )
        return Event(step, time, "WARN", text, "pace")
