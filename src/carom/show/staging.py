"""Common parts of a picture and a movie: the camera, the grids of planes, and the trails of few bodies."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import rerun.blueprint as rrb

from carom.arrays import ColourArray, FloatArray, IntArray
from carom.recording.layout.camera import CameraFit, CameraMotion, turned
from carom.recording.layout.canvas import LensView, views_of
from carom.recording.read.frame_rows import RecordedPositions
from carom.recording.read.recording import Recording
from carom.recording.schema.header import Header
from carom.recording.schema.paths import STEP
from carom.recording.write.rows import Index, Rows
from carom.recording.write.static_entities import plane_grids
from carom.show.supplement import Static, Trails, has_trails

_LOOKS = 50  # frames of many bodies to which the camera is fitted


@dataclass(frozen=True, slots=True)
class Staging:
    """A camera fitted to the motion in a recording, and additions to the bodies."""

    camera: CameraFit
    trails: Trails | None  # of few bodies
    header: Header
    origin: FloatArray  # (3,) m, of the recording

    @classmethod
    def of(
        cls,
        recording: Recording,
        header: Header,
        first: FloatArray,
        colours: ColourArray,
        until: float = np.inf,
        motion: CameraMotion | None = None,
    ) -> Staging:
        """Fit a camera to a recording.

        Parameters
        ----------
        recording, header
            The recording and its header.
        first
            (n, 3) m from the origin, positions that must be in view.
        colours
            (n,) colours of the trails.
        until
            s, the time up to which the motion should be in view.
        motion
            The camera's motion; by default it depends on the scene.
        """
        camera = CameraFit.of_scene(header, recording.origin, first, motion)
        trails = Trails(recording, header, colours) if has_trails(recording) else None
        if trails is not None:
            trails.show(camera, until)
            if not _meet(recording, header):  # orbits of bodies that may all be near their pericentres
                camera.show_all()
        elif recording.frames > 1:
            drawn, table = RecordedPositions(recording), recording.fingerprints()
            for row in np.unique(np.linspace(0, table.num_rows - 1, _LOOKS).astype(int)):
                position = drawn.drawn(int(table[STEP][int(row)].as_py())) - recording.origin
                camera.look(position, inside=table["time"][int(row)].as_py() <= until)
        return cls(camera, trails, header, recording.origin)

    def rows(self) -> Iterator[Rows]:
        """Yield the trails."""
        if self.trails is not None:
            yield from self.trails.rows()

    def statics(self) -> Iterator[Static]:
        """Yield the colours of the trails, and the planes as grids where the camera looks.

        The recorded grids are centred on the initial bodies.
        """
        if self.header.walls is None and self.header.box is None:
            seen = self.camera.view()
            yield from plane_grids(self.header, self.origin, seen.target, 0.5 * seen.height())
        if self.trails is not None:
            yield from self.trails.statics()

    def camera_rows(
        self, layout: rrb.Blueprint, steps: IntArray, times: FloatArray, positions: Sequence[FloatArray]
    ) -> Iterator[Rows]:
        """Yield the poses of the cameras that move, for positions (n, 3), in m from the origin, of some frames."""
        for shown in views_of(layout.root_container):
            if not isinstance(shown, LensView) or shown.lens.view.motion is CameraMotion.STILL:
                continue
            view = shown.lens.view
            if view.motion is CameraMotion.FOLLOW:
                poses = [replace(view, target=view.target + self.camera.offset(each)) for each in positions]
            else:
                angles = np.linspace(0.0, 2.0 * np.pi, len(steps))
                poses = [replace(view, to_eye=turned(view.to_eye, view.up, angle)) for angle in angles]
            yield Rows(shown.lens.path, Index(steps, times), shown.lens.poses(poses), 100 * len(poses))


def _meet(recording: Recording, header: Header) -> bool:
    """Return whether bodies touched, or may have touched in a killed run, whose contacts were not counted."""
    return header.collides and recording.closing.get("contacts.total") != 0
