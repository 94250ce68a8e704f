"""Rerun's private interfaces, each with a fallback for versions of Rerun that lack it.

No other module of carom uses private interfaces. Without private interfaces, recordings are written, read, resumed and
shown in the same way, but more memory stays allocated, and a clip loses its layout. test_rerun_compat.py tries each
interface and each fallback, as a canary for new versions of rerun-sdk. Version 0.41 is the first whose viewer renders
pictures; version 0.40 can only record and replay.

The page of `carom view --web` drives the web viewer by the undocumented interface of Rerun's `re_viewer.js`. The slow
test in tests/display/test_web.py tries this interface in a browser.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

import pyarrow as pa
import rerun as rr
import rerun.blueprint as rrb
import rerun.chunk as rrc

from carom.errors import DamageError, RecordingError
from carom.recording.layout.canvas import log_spaces
from carom.recording.rrd.messages import Chunk

bindings: Any
try:
    import rerun_bindings as bindings
except ImportError:
    bindings = None

if TYPE_CHECKING:
    from rerun.experimental import ViewerClient
    from rerun.notebook import Viewer

_UNKNOWN = (AttributeError, TypeError)  # exceptions of a private interface that is missing or has other arguments
_TESTED = "0.41.0"
_DRIVEN_BY = ("connect", "open", "get_state", "set_time", "take_screenshot")  # methods of `ViewerClient`


def end_earlier_streams() -> None:
    """Free the threads and memory that Rerun keeps for each closed stream until `rr.init` is called.

    If Rerun lacks the private function for this, threads and memory stay allocated. A forked child lacks the threads of
    its parent and cannot end its streams; Rerun then raises RuntimeError.
    """
    with contextlib.suppress(RuntimeError, *_UNKNOWN):
        bindings.flush_and_cleanup_orphaned_recordings()


def send_layout(stream: rr.RecordingStream, application: str, layout: rrb.Blueprint) -> None:
    """Send a layout like `rr.send_blueprint`, and the transforms of its magnified spaces; close the stream used for it.

    `rr.send_blueprint`, the fallback, leaves its stream open: two threads and 4 MB for each recording of a sweep.
    """
    log_spaces(stream, layout)
    if isinstance(layout, StoredLayout) and not hasattr(rrb.Blueprint, "_log_to_stream"):
        return  # the viewer then lays the views out itself
    try:
        own = rr.RecordingStream._from_native(
            bindings.new_blueprint(application, make_default=False, make_thread_default=False)
        )
        own.set_time("blueprint", sequence=0)
        layout._log_to_stream(own)
        stored = rr.memory_recording(own).storage
        bindings.send_blueprint(stored, make_active=True, make_default=True, recording=stream.to_native())
        own.disconnect()
    except _UNKNOWN:
        rr.send_blueprint(layout, make_active=True, make_default=True, recording=stream)


def send_to_notebook(viewer: Viewer, rrd: bytes) -> None:
    """Send a file to a notebook's viewer. Rerun's public interface would read the file and write it again."""
    try:
        viewer._flush_hook(rrd)
    except _UNKNOWN:
        stream = rr.RecordingStream("carom", send_properties=False)
        viewer.add_recording(stream)
        stream.log_file_from_contents("recording.rrd", rrd)
        stream.flush()


def connect_viewer(url: str) -> ViewerClient:
    """Connect to a viewer, to drive it. Raises RecordingError if Rerun lacks the interface of version 0.41."""
    try:
        from rerun.experimental import ViewerClient  # noqa: PLC0415 - experimental, and so may move
    except ImportError:
        ViewerClient = None  # type: ignore[assignment, misc]
    if not all(hasattr(ViewerClient, name) for name in _DRIVEN_BY):
        raise RecordingError(
            f"rerun-sdk {rr.__version__} cannot render pictures as {_TESTED} can: "
            f'pip install "rerun-sdk=={_TESTED}"; recordings do not need it'
        )
    return ViewerClient.connect(url)


class StoredLayout(rrb.Blueprint):
    """A layout read from another file, sent unchanged."""

    def __init__(self, chunks: Iterable[Chunk]) -> None:
        super().__init__(rrb.Horizontal())
        self._chunks = list(chunks)

    def _log_to_stream(self, stream: rr.RecordingStream) -> None:
        for chunk in self._chunks:
            rr.send_chunks(rerun_chunks(chunk.batch), recording=stream)


def rerun_chunks(batch: pa.RecordBatch) -> list[rrc.Chunk]:
    """Return Rerun's chunks for rows read from a file, with new ids: chunks with the same id replace each other."""
    kinds = {field.name: (field.metadata or {}).get(b"rerun:kind") for field in batch.schema}
    kept = [field for field in batch.schema if kinds[field.name] != b"control"]
    timelines = [name for name, kind in kinds.items() if kind == b"index"]
    known = {key: value for key, value in batch.schema.metadata.items() if key != b"rerun:id"}
    fresh = pa.record_batch([batch[field.name] for field in kept], schema=pa.schema(kept, metadata=known))
    try:
        return rrc.Chunk.from_record_batch(fresh, index=timelines or None)
    except (RuntimeError, ValueError, TypeError) as error:
        raise DamageError(str(error)) from error
