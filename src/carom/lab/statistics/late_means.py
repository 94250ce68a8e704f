"""Granular temperature and stress of the second half of a run, as columns of a sweep's table."""

from __future__ import annotations

import contextlib

import numpy as np

from carom.errors import RecordingError
from carom.lab.statistics import Interval
from carom.lab.statistics.motion_statistics import measure_stress, peculiar
from carom.recording.read.recording import Recording

BEGINS = 0.5  # fraction of the duration after which means begin: before that, many scenes are far from a steady state
COMPONENTS = (("xx", 0, 0), ("yy", 1, 1), ("zz", 2, 2), ("xy", 0, 1), ("xz", 0, 2), ("yz", 1, 2))


def late_means(recording: Recording) -> dict[str, float]:
    """Return ``granular.temperature``, ``granular.pressure``, ``granular.stress.xx`` to ``.yz`` in recorded units.

    The stress is the mean of σ and its transpose. Columns that the recording cannot give are left out; nothing is
    simulated.
    """
    half = BEGINS * float(recording.fingerprints()["time"].to_numpy()[-1])
    interval = Interval.of(recording, half, None, False, lambda status: None)
    stored = set(interval.step.tolist()) & set(recording.checkpoint_times)
    found: dict[str, float] = {}
    moving, kinetic = interval.moving, interval.kinetic
    if np.count_nonzero(moving) > 1 and (kinetic is not None or stored):
        if kinetic is None:
            weighted = peculiar(interval.velocities[:, moving], recording.bodies.mass[moving])
            found["granular.temperature"] = float(np.nanmean(weighted * weighted))
        else:
            found["granular.temperature"] = float(np.trace(kinetic)) / (3 * np.count_nonzero(moving))
    if recording.records_contacts and (kinetic is not None or stored):
        with contextlib.suppress(RecordingError, KeyError):  # raised if some impacts or forces are unknown
            values = measure_stress(interval).values
            stress = np.asarray(values["stress"].value)
            found["granular.pressure"] = float(values["pressure"].value)
            found |= {f"granular.stress.{name}": float(stress[i, j] + stress[j, i]) / 2 for name, i, j in COMPONENTS}
    return found
