"""`Supplement`: rows and a layout that a viewer gets on top of a recording; the file does not change."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import rerun as rr
import rerun.blueprint as rrb

from carom.recording.schema.clock import Clock
from carom.recording.write.durable_sink import FLUSH
from carom.recording.write.rerun_compat import send_layout
from carom.recording.write.rows import Rows

Static = tuple[str, rr.AsComponents]


@dataclass(frozen=True, slots=True)
class Supplement:
    """Rows, static data and a layout, sent to a viewer that shows the recording."""

    layout: rrb.Blueprint
    clock: Clock  # of the recording
    rows: Sequence[Rows] = ()
    statics: Sequence[Static] = ()

    def send(self, address: str, application: str, recording_id: str) -> None:
        """Send it to the recording of these ids in the viewer at an address."""
        self._put(rr.GrpcSink(address), application, recording_id)

    def save(self, path: Path, application: str, recording_id: str) -> None:
        """Write it to a file, which a viewer loads on top of the recording of these ids."""
        self._put(rr.FileSink(path), application, recording_id)

    def _put(self, sink: rr.GrpcSink | rr.FileSink, application: str, recording_id: str) -> None:
        with rr.RecordingStream(application, recording_id=recording_id, send_properties=False) as stream:
            stream.set_sinks(sink)
            for path, archetype in self.statics:
                stream.log(path, archetype, static=True)
            for rows in self.rows:
                stream.send_columns(rows.path, self.clock.columns(rows.index.steps, rows.index.times), rows.columns)
            send_layout(stream, application, self.layout)
            stream.flush(timeout_sec=FLUSH)
            stream.disconnect()
