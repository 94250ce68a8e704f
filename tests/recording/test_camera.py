from dataclasses import replace

import numpy as np

from carom.recording.view.camera import CameraFit
from merry import Merry


def test_bodies_that_fly_off_do_not_shrink_the_rest(merry: Merry) -> None:
    frames = list(merry.frames(3))
    away = frames[2].position.copy()
    away[0] = [1e9, 0, 0]
    extent = CameraFit(merry.header.radius, frames[0].position)
    extent.see([frames[1]], np.zeros(3))
    before = extent.view().distance
    extent.see([replace(frames[2], position=away)], np.zeros(3))
    assert extent.view().distance < 1.5 * before


def test_an_explosion_leaves_the_start_visible(merry: Merry) -> None:
    frame = next(merry.frames(1))
    extent = CameraFit(merry.header.radius, frame.position)
    first = extent.view().distance
    extent.see([replace(frame, position=1000 * frame.position)], np.zeros(3))
    assert first < extent.view().distance < 3 * first


def test_bodies_that_leave_as_a_whole_are_followed(merry: Merry) -> None:
    frame = next(merry.frames(1))
    extent = CameraFit(merry.header.radius, frame.position)
    first = extent.view()
    extent.see([replace(frame, position=frame.position + np.array([1e6, 0, 0]))], np.zeros(3))
    assert not first.follows
    assert extent.view().follows
    assert extent.view().distance < 1.1 * first.distance


def test_a_run_that_ended_in_nan_can_still_be_framed(merry: Merry) -> None:
    frame = next(merry.frames(1))
    extent = CameraFit(merry.header.radius, frame.position)
    extent.see([replace(frame, position=np.full_like(frame.position, np.nan))], np.zeros(3))
    assert np.isfinite(extent.view().distance)
