"""Kernels do not check indices: what a frame holds is checked before they read it."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from carom.contact_table import CONTACT_ROW
from carom.errors import RecordingError
from carom.recording.write.encoder import BatchEncoder
from carom.state.frame import Frame
from scripted_run import ScriptedRun

BODIES = 60


def touching(run: ScriptedRun) -> Frame:
    """Return the first frame with several contacts."""
    return next(frame for frame in run.frames(200) if len(frame.contacts) > 1)


def changed(frame: Frame, name: str, values: Any) -> Frame:
    """Return a frame with another array, of the frame or of its contacts."""
    if name in ("pairs", "normals", "overlaps", "colours"):
        return replace(frame, contacts=replace(frame.contacts, **{name: values}))
    return replace(frame, **{name: values})


@pytest.mark.parametrize(
    ("name", "change", "message"),
    [
        ("position", lambda a: a[:-1], r"step \d+: position has the shape \(59, 3\) instead of \(60, 3\)"),
        ("velocity", lambda a: np.vstack((a, a)), r"step \d+: velocity has the shape \(120, 3\) instead of \(60, 3\)"),
        ("orientation", lambda a: a[:, :3], r"step \d+: orientation has the shape \(60, 3\) instead of \(60, 4\)"),
        ("torque", lambda a: None, r"step \d+: torque has the shape None instead of \(60, 3\)"),
        ("normals", lambda a: a[1:], r"step \d+: normals of contacts has the shape"),
        ("overlaps", lambda a: a[1:], r"step \d+: overlaps of contacts has the shape"),
        ("colours", lambda a: a[1:], r"step \d+: colours of contacts has the shape"),
        ("pairs", lambda a: a + BODIES, r"step \d+: a contact has a wrong body number; bodies are 0 to 59"),
        ("pairs", lambda a: a - BODIES, r"step \d+: a contact has a wrong body number; bodies are 0 to 59"),
    ],
)
def test_a_frame_whose_arrays_do_not_fit_is_refused_by_the_name_of_the_array(
    name: str, change: Any, message: str
) -> None:
    run = ScriptedRun(BODIES)
    frame = touching(run)
    values = getattr(frame, name) if hasattr(frame, name) else getattr(frame.contacts, name)
    encoder = BatchEncoder(run.header, np.zeros(3))
    assert list(encoder.rows([frame]))
    with pytest.raises(RecordingError, match=message):
        list(encoder.rows([changed(frame, name, change(values))]))


def test_an_edge_without_a_row_of_its_contact_is_refused() -> None:
    run = ScriptedRun(BODIES, record_impacts="auto")
    frame = touching(run)
    pairs = frame.contacts.pairs
    rows = np.zeros(len(pairs), CONTACT_ROW)
    rows["i"], rows["j"] = pairs.T
    list(BatchEncoder(run.header, np.zeros(3)).rows([replace(frame, contact_rows=rows)]))
    for lacking in (rows[:0], rows[:-1], rows[1:]):
        with pytest.raises(RecordingError, match=r"contact of \d+ and \d+ is in the collision graph, but has no row"):
            list(BatchEncoder(run.header, np.zeros(3)).rows([replace(frame, contact_rows=lacking)]))
