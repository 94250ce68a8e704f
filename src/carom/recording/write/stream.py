"""`Stream`: sends rows, properties and layouts to the file and to a live viewer."""

from __future__ import annotations

import os
import socket
import threading
import warnings
from collections.abc import Iterable, Mapping
from pathlib import Path
from time import monotonic

import rerun as rr

from carom.arrays import FloatArray
from carom.errors import RecordingError
from carom.recording.read.frame_rows import Continuation
from carom.recording.rrd.messages import release_memory
from carom.recording.schema import checkpoint_columns, paths
from carom.recording.schema.header import Header, Scalar, TimeScale, application_id
from carom.recording.write.durable_sink import FLUSH, DurableSink
from carom.recording.write.partial_frames import Lives
from carom.recording.write.rerun_compat import end_earlier_streams, rerun_chunks, send_layout
from carom.recording.write.rows import Index, Rows, any_values, joined, kind_of, time_columns
from carom.recording.write.static_entities import identity, statics

# A second stream leads to a running viewer. The viewer may close at any time; the recording continues.

_PROBE = 2.0  # s, time limit of a first connection
_PATIENCE = 5.0  # s; a viewer that takes longer for one second of frames counts as hung


class LiveView:
    """Also sends the recorded data to a running viewer."""

    def __init__(self, address: str, application_id: str, run_id: str) -> None:
        host, separator, port = address.rpartition(":")
        if not separator or not port.isdigit():
            raise RecordingError(f"a live viewer's address is HOST:PORT, for example 127.0.0.1:9876, not {address!r}")
        host = host or "127.0.0.1"
        try:  # without a listener, a sink would block for seconds, both now and at exit
            socket.create_connection((host, int(port)), timeout=_PROBE).close()
        except OSError as error:
            raise RecordingError(
                f"no viewer listens at {host}:{port} ({error.strerror or error}); start one with: rerun --bind {host}"
            ) from error
        self._stream: rr.RecordingStream | None = rr.RecordingStream(application_id, recording_id=run_id)
        self._stream.set_sinks(rr.GrpcSink(f"rerun+http://{host}:{int(port)}/proxy"))

    def streams(self) -> tuple[rr.RecordingStream, ...]:
        """Return the viewer's stream in a list, which is empty once the viewer has closed."""
        return () if self._stream is None else (self._stream,)

    def flush(self) -> None:
        """Wait until the viewer has received everything; stop sending to a closed viewer, whose queue would grow."""
        if self._stream is None:
            return
        try:
            self._stream.flush(timeout_sec=_PATIENCE)
        except RuntimeError:
            warnings.warn("the live viewer has closed; the recording continues without it", stacklevel=2)
            self._hang_up()

    def close(self) -> None:
        """Send the remaining data and disconnect."""
        self.flush()
        self._hang_up()

    def _hang_up(self) -> None:
        """Disconnect; give up on a viewer that does not answer within `_PATIENCE`."""
        if self._stream is not None:
            disconnecting = threading.Thread(target=self._stream.disconnect, name="carom-live-end", daemon=True)
            disconnecting.start()
            disconnecting.join(_PATIENCE)
            self._stream = None


BATCH_BYTES = 4_000_000  # a batch costs some milliseconds, whatever its size
_BODY_BYTES, _FRAME_BYTES = 40, 500  # bytes of a frame: for each body with its arrows, and for scalars

# Rerun's encoder keeps 5.7 kB of memory and 1.2 kB of the footer for each message, and a batch has some 60. A long run
# therefore joins batches, so that their number grows logarithmically with time and size: 28 800 batches make a footer
# of 2 GB, the largest readable footer.
PROMPT_BATCHES = 100  # number of first batches that are written without joining
OF_TIME = 0.01  # largest fraction of its run time that a killed run may lose
OF_SIZE = 0.004  # largest fraction of its recorded bytes that a killed run may lose
JOINED_BYTES = 64_000_000  # largest joined batch, for recordings above 16 GB; 28 800 such batches are 1.8 TB
_ENCODED = 1.3  # largest ratio of bytes in the file to bytes of data
_ENDING = 400_000  # bytes for blueprint, properties and the footer of a small recording
_CONTINUED_BYTES = 16_000_000  # bytes of continued frames that may wait in Rerun's encoder
_FOOTER_BYTES = 120  # bytes of the footer for each message; 50 were measured


def frames_in_batch(bodies: int) -> int:
    """Return the number of frames that fill a batch, given the number of bodies; 0 if one frame is larger."""
    return BATCH_BYTES // (_BODY_BYTES * bodies + _FRAME_BYTES)


class Stream:
    """Sends recorded data to a new ``file``, by default ``path``; counts bytes, and raises when the disk is full."""

    def __init__(
        self, path: Path, header: Header, *, batch_bytes: int, live: str | None, file: Path | None = None
    ) -> None:
        self.path = path
        self.payload_bytes = 0
        self._header = header
        self._indexed: Index | None = None
        self._index: list[rr.TimeColumn] = []
        self._waiting: dict[tuple[object, TimeScale], list[Rows]] = {}  # rows of batches to be joined, by kind
        self._waiting_bytes = 0
        self._batches = 0
        self._opened = self._written = monotonic()
        self._application = application_id(header)
        self._live = None if live is None else LiveView(live, self._application, header.run_id)
        # reserve for the current batch when the disk fills up, for the last checkpoint, and for the end of the file
        self._reserve = int(_ENCODED * batch_bytes) + checkpoint_columns.largest_size(header) + _ENDING
        rr.set_strict_mode(True)  # otherwise bad data would only cause a warning, and the row would be lost
        self._sink = DurableSink(file or path, self._reserve)
        end_earlier_streams()
        self._stream = rr.RecordingStream(self._application, recording_id=header.run_id)
        self._stream.set_sinks(rr.FileSink(self._sink.entry))
        self._sink.opened()

    @property
    def is_live(self) -> bool:
        """Whether a live viewer is connected."""
        return self._live is not None

    def send(self, rows: Rows, clock: TimeScale) -> None:
        """Send one entity's rows: at once to a live viewer, and to the file when its batch is due."""
        self.payload_bytes += rows.bytes
        if self._batches < PROMPT_BATCHES:
            self._send(rows, clock, self._streams())
            return
        self._waiting.setdefault((kind_of(rows), clock), []).append(rows)
        self._waiting_bytes += rows.bytes
        if self._live is not None:
            self._send(rows, clock, self._live.streams())

    def _send(self, rows: Rows, clock: TimeScale, streams: Iterable[rr.RecordingStream]) -> None:
        if (index := rows.index) is not self._indexed:  # most entities of a batch share an index
            self._indexed, self._index = index, time_columns(clock, *index)
        for stream in streams:
            stream.send_columns(rows.path, self._index, rows.columns)

    @property
    def patience(self) -> float | None:
        """Seconds after which waiting rows have to be written; None if none wait."""
        if not self._waiting:
            return None
        now = monotonic()
        return max(0.0, self._written + OF_TIME * (now - self._opened) - now)

    @property
    def _largest(self) -> int:
        """Largest number of bytes of waiting rows."""
        return max(BATCH_BYTES, min(JOINED_BYTES, int(OF_SIZE * self.payload_bytes)))

    def _send_waiting(self) -> None:
        """Send the waiting rows; rows of one kind are joined."""
        waiting, self._waiting, self._waiting_bytes = self._waiting, {}, 0
        for (_, clock), rows in waiting.items():
            self._send(joined(rows), clock, (self._stream,))

    def send_continued(self, continued: Continuation) -> None:
        """Send the frames that a resumed run continues; raises if the disk is full."""
        sent = 0
        for chunk in continued.chunks():
            for stream in self._streams():
                stream.send_chunks(rerun_chunks(chunk.batch))
            self.payload_bytes += chunk.batch.nbytes
            sent += chunk.batch.nbytes
            del chunk
            if sent > _CONTINUED_BYTES:
                sent = 0
                self.flush()
                release_memory()

    def send_statics(self, clock: TimeScale, origin: FloatArray, reach: float) -> None:
        """Send the static data; at the start all bodies are within ``reach`` (m) of the origin."""
        for stream in self._streams():
            stream.send_recording_name(self._header.member.name if self._header.member else self._header.title)
        self.send_property("carom", identity(self._header, clock, origin))
        self.send_property("run", self._header.properties)
        if self._header.member:
            self.send_property("sweep", {"name": self._header.member.name, **self._header.member.parameters})
        for path, archetype in statics(self._header, clock, origin, reach):
            for stream in self._streams():
                stream.log(path, archetype, static=True)
            self.payload_bytes += sum(batch.as_arrow_array().nbytes for batch in archetype.as_component_batches())

    def send_bodies(self, header: Header, clock: TimeScale, origin: FloatArray, lives: Lives) -> None:
        """If bodies come and go, send the static data of all bodies so far. These data replace earlier static data."""
        self.send_property("carom", {"bodies": header.bodies})
        if header.drawn_as:
            self.send_property("carom", {"drawn_as": header.drawn_as})
        changed = (paths.ABOUT, paths.SCENE, paths.BODIES, paths.STATIC_STATE)
        archetypes = [each for each in statics(header, clock, origin, 1.0) if each[0] in changed]
        for path, archetype in [*archetypes, (paths.LIVES, any_values(lives.columns()))]:
            for stream in self._streams():
                stream.log(path, archetype, static=True)

    def send_property(self, name: str, values: Mapping[str, Scalar | FloatArray]) -> None:
        """Send a recording property, unless it is empty."""
        for stream in self._streams():
            if values:
                stream.send_property(name, any_values(values))

    def send_blueprint(self, layout: rr.blueprint.Blueprint) -> None:
        """Send a layout; the file opens with the last layout sent."""
        for stream in self._streams():
            send_layout(stream, self._application, layout)

    def flush(self) -> None:
        """End a batch, and wait until all due batches are in the file; raise an error if they cannot be written."""
        if not self._waiting or self._waiting_bytes >= self._largest or not self.patience:
            self._send_waiting()
            self._batches, self._written = self._batches + 1, monotonic()
            self._stream.flush(timeout_sec=FLUSH)
            self._sink.drain()
            waiting = int(_ENCODED * self._largest) if self._batches >= PROMPT_BATCHES else 0
            self._sink.reserve(self._reserve + waiting + _FOOTER_BYTES * self._sink.messages)
        if self._live is not None:
            self._live.flush()
        if self._sink.error is not None:
            raise RecordingError(f"cannot write {self.path}: {self._sink.error.strerror}")
        if self._sink.gone:
            raise RecordingError(f"{self._sink.path} was removed or renamed while it was written")
        if self._sink.full:
            raise RecordingError(f"cannot write more of {self.path}: no space left on the disk")

    def close(self) -> None:
        """Write the waiting rows and the footer, and close the file; raises if it cannot be written."""
        self._send_waiting()
        self._stream.disconnect()
        del self._stream  # deleted here, because in the main thread the stream's destructor would drop an interrupt
        self._sink.close()
        if self._live is not None:
            self._live.close()
        if self._sink.error is not None:
            raise RecordingError(f"cannot finish {self.path}: {os.strerror(self._sink.error.errno or 0)}")

    def _streams(self) -> tuple[rr.RecordingStream, ...]:
        return (self._stream, *(() if self._live is None else self._live.streams()))
