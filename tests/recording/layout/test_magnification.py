"""Small scenes are magnified for Rerun's camera, which sees nothing nearer than 0.01 units."""

from pathlib import Path

import numpy as np
import pytest
import rerun as rr
import rerun.blueprint as rrb
from rerun.chunk import RrdReader

from carom.recording.layout.canvas import NEAREST, CameraMotion, View, scale, space, spatial_view
from carom.recording.write.chunk_writer import Writer


@pytest.mark.parametrize("distance", [1e-12, 3e-3, 0.0499, 0.05, 0.499])
def test_the_camera_is_half_a_unit_to_five_units_from_what_it_looks_at(distance: float) -> None:
    assert NEAREST <= distance * scale(space(distance)) < 10 * NEAREST * (1 + 1e-15)  # by rounding of the power of ten


@pytest.mark.parametrize("distance", [NEAREST, 1e3, 1e13, np.inf, 0.0])
def test_scenes_of_metres_are_shown_as_they_are(distance: float) -> None:
    assert space(distance) == "/"


def test_a_file_has_the_transforms_of_the_magnified_views_of_its_layout(tmp_path: Path) -> None:
    near = View(np.array([1e-3, 0.0, 0.0]), 4e-3, CameraMotion.STILL, np.array([0.0, -1.0, 0.0]))
    views = [spatial_view("near", near, []), rrb.Spatial3DView(origin="/")]
    with Writer(tmp_path / "near.rrd", "carom-test", "near") as writer:
        writer.log("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP)
        writer.send_layout(rrb.Blueprint(rrb.Horizontal(*views)))
        writer.flush()
    chunks = {
        str(chunk.entity_path): chunk for chunk in RrdReader(tmp_path / "near.rrd").store().stream() if chunk.is_static
    }
    assert [path for path in chunks if "magnified" in path] == ["/magnified/3"]
    (shrunk,) = chunks["/magnified/3"].to_record_batch()["Transform3D:scale"].to_pylist()
    assert shrunk == [pytest.approx([1e-3] * 3)]
