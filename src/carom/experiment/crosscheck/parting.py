"""Where a run leaves the reference, and which laws it breaks there."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from carom.experiment.work_precision.reference import Reference
from carom.experiment.work_precision.trajectory import Trajectory
from carom.scene.names import Names

PARTED = 0.01  # of the size of the system; runs farther apart have diverged
EARLIER = 2.0  # steps, by which an engine may see an impact before the reference does
LATER = 40.0  # steps after it, in which a soft contact ends


@dataclass(frozen=True, slots=True)
class Parting:
    """Where a run leaves the reference."""

    time: float  # s, of the first sample that is too far away
    impact: int  # the number of the last pair that met before, from 1 on; 0 if none had
    between: str  # its names
    impact_time: float  # s
    laws: list[str]  # that were broken from that impact on


def parting_of(
    run: Trajectory, reference: Reference, broken: list[tuple[float, str]], dt: float, names: Names
) -> Parting | None:
    """Find where a run leaves a reference.

    Parameters
    ----------
    run
        The run.
    reference
        Its samples up to the horizon are compared.
    broken
        Times in s and laws of the frames that broke one, in order.
    dt
        s, the step of the run.
    names
        Of bodies and planes.

    Returns
    -------
    parting
        None if the run stays with the reference.
    """
    best = reference.trajectory.until(reference.samples)
    apart, _ = reference.scale.apart(run.until(reference.samples), best)
    away = np.flatnonzero(~(apart <= PARTED))
    if len(away) == 0 and len(run) >= reference.samples:
        return None
    time = float(best.time[away[0]]) if len(away) else float(run.time[-1])
    earlier = [k for k in np.argsort(best.met, kind="stable").tolist() if best.met[k] <= time]
    last = earlier[-1] if earlier else None
    met = float(best.met[last]) if last is not None else 0.0
    laws = dict.fromkeys(law for at, law in broken if met - EARLIER * dt <= at <= max(time, met + LATER * dt))
    return Parting(
        time=time,
        impact=len(earlier),
        between=names.pair(best.pair[last].tolist()) if last is not None else "",
        impact_time=met,
        laws=list(laws),
    )
