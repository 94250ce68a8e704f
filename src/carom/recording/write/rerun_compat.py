"""What both writers of recordings hand to Rerun: a layout, and chunks of another file."""

from __future__ import annotations

import pyarrow as pa
import rerun as rr
import rerun.chunk as rrc
import rerun_bindings

from carom.recording.errors import DamageError


def end_earlier_streams() -> None:
    """End what Rerun 0.41 keeps of closed streams until someone asks, as `rr.init` does: threads and megabytes."""
    rerun_bindings.flush_and_cleanup_orphaned_recordings()


def send_layout(stream: rr.RecordingStream, application: str, layout: rr.blueprint.Blueprint) -> None:
    """Do as `rr.send_blueprint` does, and end the stream that it makes for the purpose.

    Rerun 0.41 leaves that stream open for good: two threads and 4 MB for each recording of a sweep.
    """
    own = rr.RecordingStream._from_native(
        rerun_bindings.new_blueprint(application, make_default=False, make_thread_default=False)
    )
    own.set_time("blueprint", sequence=0)
    layout._log_to_stream(own)
    stored = rr.memory_recording(own).storage
    rerun_bindings.send_blueprint(stored, make_active=True, make_default=True, recording=stream.to_native())
    own.disconnect()


def rerun_chunks(batch: pa.RecordBatch) -> list[rrc.Chunk]:
    """Hand rows over to Rerun, as new ones: their ids are those of another file."""
    kinds = {field.name: (field.metadata or {}).get(b"rerun:kind") for field in batch.schema}
    kept = [field for field in batch.schema if kinds[field.name] != b"control"]
    timelines = [name for name, kind in kinds.items() if kind == b"index"]
    known = {key: value for key, value in batch.schema.metadata.items() if key != b"rerun:id"}
    fresh = pa.record_batch([batch[field.name] for field in kept], schema=pa.schema(kept, metadata=known))
    try:
        return rrc.Chunk.from_record_batch(fresh, index=timelines or None)
    except (RuntimeError, ValueError, TypeError) as error:
        raise DamageError(str(error)) from error
