"""Rerun's private interfaces, and the undocumented behaviour of Rerun 0.41 that carom relies on.

Nothing else in carom uses them. test_rerun_compat.py has a test for each; run it before the upper bound of rerun-sdk in
pyproject.toml is raised.

The page of `carom view --web` drives the web viewer by the undocumented interface of Rerun's `re_viewer.js`. The slow
test of tests/show/test_web.py tries it in a browser.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterable
from typing import TYPE_CHECKING

import pyarrow as pa
import rerun as rr
import rerun.blueprint as rrb
import rerun.chunk as rrc
import rerun_bindings

from carom.errors import DamageError
from carom.recording.layout.magnification import log_spaces
from carom.recording.rrd.messages import Chunk

if TYPE_CHECKING:
    from rerun.notebook import Viewer


def end_earlier_streams() -> None:
    """Free the threads and megabytes that Rerun keeps of each closed stream until `rr.init` is called.

    A forked child cannot end the streams of its parent, whose threads it does not have; Rerun raises RuntimeError.
    """
    with contextlib.suppress(RuntimeError):
        rerun_bindings.flush_and_cleanup_orphaned_recordings()


def send_layout(stream: rr.RecordingStream, application: str, layout: rrb.Blueprint) -> None:
    """Send a layout as `rr.send_blueprint` does, and close the stream that it is sent through.

    The recording gets the transforms of the magnified spaces that the layout has.

    `rr.send_blueprint` leaves that stream open: two threads and 4 MB for each recording of a sweep.
    """
    log_spaces(stream, layout)
    own = rr.RecordingStream._from_native(
        rerun_bindings.new_blueprint(application, make_default=False, make_thread_default=False)
    )
    own.set_time("blueprint", sequence=0)
    layout._log_to_stream(own)
    stored = rr.memory_recording(own).storage
    rerun_bindings.send_blueprint(stored, make_active=True, make_default=True, recording=stream.to_native())
    own.disconnect()


def send_to_notebook(viewer: Viewer, rrd: bytes) -> None:
    """Give a notebook's viewer a file; Rerun's own way is a stream that writes the recording a second time."""
    viewer._flush_hook(rrd)


class StoredLayout(rrb.Blueprint):
    """A layout read from another file, sent as it is."""

    def __init__(self, chunks: Iterable[Chunk]) -> None:
        super().__init__(rrb.Horizontal())
        self._chunks = list(chunks)

    def _log_to_stream(self, stream: rr.RecordingStream) -> None:
        for chunk in self._chunks:
            rr.send_chunks(rerun_chunks(chunk.batch), recording=stream)


def rerun_chunks(batch: pa.RecordBatch) -> list[rrc.Chunk]:
    """Make Rerun's chunks of rows read from a file, with new ids: two chunks of one id would replace each other."""
    kinds = {field.name: (field.metadata or {}).get(b"rerun:kind") for field in batch.schema}
    kept = [field for field in batch.schema if kinds[field.name] != b"control"]
    timelines = [name for name, kind in kinds.items() if kind == b"index"]
    known = {key: value for key, value in batch.schema.metadata.items() if key != b"rerun:id"}
    fresh = pa.record_batch([batch[field.name] for field in kept], schema=pa.schema(kept, metadata=known))
    try:
        return rrc.Chunk.from_record_batch(fresh, index=timelines or None)
    except (RuntimeError, ValueError, TypeError) as error:
        raise DamageError(str(error)) from error
