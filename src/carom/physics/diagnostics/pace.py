"""A warning when the steps of a run have become so short that it takes many times as many as its start promised."""

from __future__ import annotations

from dataclasses import dataclass

from carom.physics.event import Event

CRAWL = 5.0  # times as many steps as at the pace of the first one
MIN_STEPS = 50_000  # a run of fewer is over before anybody could act on a warning

REMEDY = {  # what makes the steps longer that a limit sets
    "acceleration": "time.target_dx",
    "held": "time.target_dx",
    "velocity": "time.cfl",
    "pull": "time.pull_fraction",
    "cap": "time.max_dt",
    "fixed": "time.fixed_dt",
}


@dataclass(frozen=True, slots=True)
class PaceTally:
    """What the monitor knows from one look to the next."""

    slow_since: float | None = None  # s, from when on all steps looked at were short; None if the last one was not
    told: bool = False


class PaceMonitor:
    """Checks the step now and then, and warns once if the run crawls.

    Parameters
    ----------
    duration
        s, of the scene.
    first_dt
        s, the step at its start.
    """

    def __init__(self, duration: float, first_dt: float) -> None:
        self._duration = duration
        self._first_dt = first_dt
        self.tally = PaceTally()

    def look(self, step: int, time: float, dt: float, limit: str) -> Event | None:
        """Check the next step, of dt seconds, and the limit that sets it; return a warning the first time it crawls.

        A run crawls if it would take that many steps at the pace so far, and also at the pace of the next step.
        """
        short = CRAWL * dt < self._first_dt
        since = self.tally.slow_since if self.tally.slow_since is not None else time
        self.tally = PaceTally(since if short else None, self.tally.told)
        promised = self._duration / self._first_dt
        whole = min(step * self._duration / time, step + max(0.0, self._duration - time) / dt)
        if not short or self.tally.told or whole < max(MIN_STEPS, CRAWL * promised):
            return None
        self.tally = PaceTally(since, told=True)
        text = (
            f"The step is set by the limit {limit}, and {self._first_dt / dt:.3g} times shorter than the first, "
            f"since t = {since:.6g} s: at this pace the run takes {whole:.3g} steps, {whole / promised:.3g} times "
            f"as many as its start promised. To shorten it raise {REMEDY[limit]}."
        )
        return Event(step, time, "WARN", text, "pace")
