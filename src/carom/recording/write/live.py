"""A second stream, to a running viewer. The viewer may close at any time; the recording continues."""

from __future__ import annotations

import socket
import threading
import warnings

import rerun as rr

from carom.errors import RecordingError

_PROBE = 2.0  # s
_PATIENCE = 5.0  # s; a viewer that takes longer for one second of frames counts as hung


class LiveView:
    """Sends the recorded data to a running viewer, too."""

    def __init__(self, address: str, application_id: str, run_id: str) -> None:
        host, port = _host_and_port(address)
        _probe(host, port)  # without a listener, a sink would block for seconds, here and at exit
        self._stream: rr.RecordingStream | None = rr.RecordingStream(application_id, recording_id=run_id)
        self._stream.set_sinks(rr.GrpcSink(f"rerun+http://{host}:{port}/proxy"))

    def streams(self) -> tuple[rr.RecordingStream, ...]:
        """Return the stream to send to, or none once the viewer has closed."""
        return () if self._stream is None else (self._stream,)

    def flush(self) -> None:
        """Wait until the viewer has received everything; stop sending if it has closed, since the queue would grow."""
        if self._stream is None:
            return
        try:
            self._stream.flush(timeout_sec=_PATIENCE)
        except RuntimeError:
            warnings.warn("the live viewer has gone; the recording goes on without it", stacklevel=2)
            self._hang_up()

    def close(self) -> None:
        """Send the remaining data and disconnect."""
        self.flush()
        self._hang_up()

    def _hang_up(self) -> None:
        """Disconnect; a viewer that does not answer is left after `_PATIENCE`."""
        if self._stream is not None:
            disconnecting = threading.Thread(target=self._stream.disconnect, name="carom-live-end", daemon=True)
            disconnecting.start()
            disconnecting.join(_PATIENCE)
            self._stream = None


def _host_and_port(address: str) -> tuple[str, int]:
    host, separator, port = address.rpartition(":")
    if not separator or not port.isdigit():
        raise RecordingError(f"a live viewer's address is HOST:PORT, for example 127.0.0.1:9876, not {address!r}")
    return host or "127.0.0.1", int(port)


def _probe(host: str, port: int) -> None:
    try:
        socket.create_connection((host, port), timeout=_PROBE).close()
    except OSError as error:
        raise RecordingError(
            f"no viewer listens at {host}:{port} ({error.strerror or error}); start one with: rerun --bind {host}"
        ) from error
