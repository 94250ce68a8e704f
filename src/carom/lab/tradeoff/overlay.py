"""Records a study: trajectories of the settings over the reference."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from carom.lab.tradeoff.tradeoff import Study
from carom.physics.space import Space
from carom.show.trajectories import ComparedTrajectory, write_trajectories


def record(study: Study, path: Path) -> None:
    """Write a study's trajectories into one ``.rrd``, in place of an earlier one.

    Raises
    ------
    RecordingError
        If it cannot be written.
    """
    reference = study.reference
    if reference is None or not len(reference.trajectory):
        return
    trajectories = [ComparedTrajectory(f"reference, {reference.kind}", reference.trajectory.position, np.empty(0))]
    longest = reference.trajectory
    for result in study.results:
        if result.status == "measured":
            run = study.trajectory(result)
            distance, _ = reference.scale.apart(run, reference.trajectory)
            compared = ComparedTrajectory(result.setting.name, run.position, distance, result.setting.engine)
            trajectories.append(compared)
            longest = run
    write_trajectories(path, study.scene.title, longest.time, Space(study.scene, 1).state.radius, trajectories)
