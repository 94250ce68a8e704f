"""`Writer`: a recording made of the chunks of other files."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Self

import rerun as rr
import rerun.blueprint as rrb

from carom.arrays import IntArray
from carom.errors import RecordingError
from carom.recording.rrd.container import Container
from carom.recording.rrd.messages import Chunk
from carom.recording.schema.header import Scalar
from carom.recording.write.durable_sink import FLUSH, DurableSink
from carom.recording.write.rerun_compat import end_earlier_streams, rerun_chunks, send_layout
from carom.recording.write.rows import any_values
from carom.recording.write.whole_file import Claim


class Writer:
    """Writes an .rrd from the chunks of other files under a temporary name, and renames it once it is complete.

    At the end of the context, the file is closed and gets its name; after an exception, the unfinished file is removed.
    """

    def __init__(self, path: Path, application_id: str, recording_id: str) -> None:
        rr.set_strict_mode(True)
        self.path = path
        self._claim = Claim(path)
        self._application = application_id
        self._part = path.with_name(f".{path.name}.{os.getpid()}.part")
        try:
            self._sink = DurableSink(self._part, 0)
        except RecordingError:
            self._claim.release()
            raise
        end_earlier_streams()
        # the name and the start of the recording are among the chunks to be copied
        self._stream = rr.RecordingStream(application_id, recording_id=recording_id, send_properties=False)
        self._stream.set_sinks(rr.FileSink(self._sink.entry))
        self._sink.opened()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: object, error: BaseException | None, traceback: object) -> None:
        """Close the file. Raise RecordingError if some of the data are not in the file."""
        try:
            self._stream.disconnect()
            self._sink.close()
            if error is None:
                self._fail_if_full()
                if not Container.open(self._part).finished:
                    raise RecordingError(f"{self.path} was written, but not completed")
                self._part.replace(self.path)
        finally:
            self._part.unlink(missing_ok=True)
            self._claim.release()

    def send(self, chunk: Chunk) -> None:
        """Send rows of an entity."""
        for part in rerun_chunks(chunk.batch):
            rr.send_chunks(part, recording=self._stream)

    def send_columns(self, path: str, index: list[rr.TimeColumn], columns: rr.ComponentColumnList) -> None:
        """Send new rows of an entity."""
        self._stream.send_columns(path, index, columns)

    def log(self, path: str, archetype: rr.AsComponents) -> None:
        """Send static data."""
        self._stream.log(path, archetype, static=True)

    def send_property(self, name: str, values: Mapping[str, Scalar | IntArray]) -> None:
        """Send a recording property, which the file then holds before all later data."""
        self._stream.send_property(name, any_values(values))
        # Rerun's encoder would otherwise write the property at the end, after the chunks
        self._stream.flush(timeout_sec=FLUSH)

    def send_layout(self, layout: rrb.Blueprint) -> None:
        """Send the layout that the file opens with."""
        send_layout(self._stream, self._application, layout)

    def flush(self) -> None:
        """Wait until everything sent is in the file; raise an error if it cannot be written."""
        self._stream.flush(timeout_sec=FLUSH)
        self._sink.drain()
        self._fail_if_full()

    def _fail_if_full(self) -> None:
        if self._sink.error is not None:
            raise RecordingError(f"cannot write {self.path}: {self._sink.error.strerror}")
