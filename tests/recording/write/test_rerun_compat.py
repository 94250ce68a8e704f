"""The private parts of Rerun that carom uses behave as needed, and carom works without them."""

from __future__ import annotations

import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pyarrow as pa
import pytest
import rerun as rr
import rerun.blueprint as rrb
import rerun_bindings
from rerun.notebook import Viewer

import carom
from carom.errors import RecordingError
from carom.recording.edit.clip import clip
from carom.recording.read.recording import Recording
from carom.recording.rrd.container import Container
from carom.recording.rrd.messages import BLUEPRINT, RECORDING, Chunk
from carom.recording.timelines import SIM_TIME, STEP
from carom.recording.write import rerun_compat
from carom.recording.write.durable_sink import DurableSink
from carom.recording.write.rerun_compat import (
    StoredLayout,
    connect_viewer,
    end_earlier_streams,
    rerun_chunks,
    send_layout,
    send_to_notebook,
)
from carom.runs.replay import replay
from carom.runs.resume import continue_run, resumable_run
from small_scenes import pair

APPLICATION = "carom-2-0123456789ab"


def stream_to(path: Path) -> rr.RecordingStream:
    stream = rr.RecordingStream(APPLICATION, recording_id="5e0f5d0e-9c0b-4f53-8a4c-1d2d6b1f3a77")
    stream.set_sinks(rr.FileSink(path))
    return stream


def threads() -> int:
    """Threads of this process, those of Rerun included."""
    if not Path("/proc/self/task").exists():
        pytest.skip("Rerun's threads are counted in /proc")
    return len(list(Path("/proc/self/task").iterdir()))


def ended_down_to(count: int) -> bool:
    """Whether no more threads than that are left once closed streams are ended; they may take a moment."""
    end_earlier_streams()
    limit = time.monotonic() + 30.0
    while threads() > count and time.monotonic() < limit:
        time.sleep(0.05)
    return threads() <= count


def chunks(path: Path, kind: int) -> list[Chunk]:
    container = Container.open(path)
    return [chunk for store in container.stores if store.kind == kind for chunk in container.chunks(store.entries)]


def contents(found: list[Chunk]) -> list[tuple[str, list[tuple[str, str]]]]:
    """Paths and components, without the ids, which are new in each file."""
    return sorted((c.entity_path, [(n, repr(c.batch[n].to_pylist())) for n in sorted(c.components)]) for c in found)


def test_a_layout_is_sent_active_and_its_stream_can_be_ended(tmp_path: Path) -> None:
    stream = stream_to(tmp_path / "x.rrd")
    stream.log("a", rr.TextDocument("a"), static=True)
    end_earlier_streams()
    before = threads()
    for name in ("first", "second", "third"):
        send_layout(stream, APPLICATION, rrb.Blueprint(rrb.Spatial3DView(name=name)))
    assert ended_down_to(before)
    stream.disconnect()
    layouts = [store for store in Container.open(tmp_path / "x.rrd").stores if store.kind == BLUEPRINT]
    assert len(layouts) == 3  # the index leaves out a layout that was never activated
    assert {store.application_id for store in layouts} == {APPLICATION}


def test_a_layout_of_another_file_is_sent_as_it_was(run_file: Path, tmp_path: Path) -> None:
    stream = stream_to(tmp_path / "copy.rrd")
    send_layout(stream, APPLICATION, StoredLayout(Recording.open(run_file).layout()))
    stream.disconnect()
    assert contents(chunks(tmp_path / "copy.rrd", BLUEPRINT)) == contents(chunks(run_file, BLUEPRINT))


def test_rows_of_another_file_are_sent_as_they_were_under_new_ids(run_file: Path, tmp_path: Path) -> None:
    rows = [chunk for chunk in chunks(run_file, RECORDING) if chunk.entity_path in ("energy/total", "state/checkpoint")]
    stream = rr.RecordingStream(APPLICATION, recording_id="5e0f5d0e-9c0b-4f53-8a4c-1d2d6b1f3a78", send_properties=False)
    stream.set_sinks(rr.FileSink(tmp_path / "copy.rrd"))
    for chunk in rows:
        rr.send_chunks(rerun_chunks(chunk.batch), recording=stream)
    stream.disconnect()
    copied = chunks(tmp_path / "copy.rrd", RECORDING)
    assert contents(copied) == contents(rows)
    assert [chunk.batch[STEP] for chunk in copied if not chunk.is_static] == [
        c.batch[STEP] for c in rows if not c.is_static
    ]
    ids = [{chunk.batch.schema.metadata[b"rerun:id"] for chunk in found} for found in (rows, copied)]
    assert not ids[0] & ids[1]


def test_ending_earlier_streams_ends_the_threads_of_closed_streams(tmp_path: Path) -> None:
    end_earlier_streams()
    before = threads()
    for k in range(4):
        stream = stream_to(tmp_path / f"{k}.rrd")
        stream.log("a", rr.TextDocument("a"), static=True)
        stream.disconnect()
        del stream
    assert ended_down_to(before)


def test_a_file_sink_writes_into_a_pipe_and_closes_it_when_it_is_disconnected(tmp_path: Path) -> None:
    sink = DurableSink(tmp_path / "x.rrd", 0)
    stream = rr.RecordingStream(APPLICATION, recording_id="5e0f5d0e-9c0b-4f53-8a4c-1d2d6b1f3a77")
    stream.set_sinks(rr.FileSink(sink.entry))
    sink.opened()
    steps = np.arange(100)
    times = [rr.TimeColumn(STEP, sequence=steps), rr.TimeColumn(SIM_TIME, duration=steps)]
    stream.send_columns("a", times, rr.Scalars.columns(scalars=np.sqrt(steps)))
    stream.flush(timeout_sec=60.0)
    sink.drain()
    assert sink.written == (tmp_path / "x.rrd").stat().st_size > 800  # what was flushed is in the file
    stream.disconnect()
    sink.close()
    container = Container.open(tmp_path / "x.rrd")
    assert container.finished and sink.error is None
    (chunk,) = [c for c in chunks(tmp_path / "x.rrd", RECORDING) if c.entity_path == "a"]
    assert pa.compute.list_flatten(chunk.batch["Scalars:scalars"]).to_pylist() == np.sqrt(steps).tolist()


@pytest.mark.needs("rerun_notebook")
def test_a_notebook_viewer_passes_a_file_on_as_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    sent: list[bytes] = []
    monkeypatch.setattr("rerun_notebook.Viewer.send_rrd", lambda _, data: sent.append(data))
    send_to_notebook(Viewer(width=100, height=100, use_global_recording=False), b"a file")
    assert sent == [b"a file"]


def takes_nothing() -> None:
    """Stand in for a private function whose signature is another one now."""


@pytest.mark.parametrize("how", ["missing", "with another signature"])
@pytest.mark.parametrize("private", ["all", "flush_and_cleanup_orphaned_recordings", "new_blueprint", "send_blueprint"])
def test_without_a_private_interface_a_run_is_recorded_read_resumed_and_clipped(
    private: str, how: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # only carom's view of it is changed: the public functions of this version of Rerun need it themselves
    known = {} if private == "all" else {**vars(rerun_bindings), private: takes_nothing}
    if how == "missing":
        known.pop(private, None)
    monkeypatch.setattr(rerun_compat, "bindings", SimpleNamespace(**known))
    recording = carom.run(pair(time={"duration": 0.2, "max_dt": 0.02}), tmp_path / "run.rrd")
    run = resumable_run(recording, 0.3)
    assert continue_run(run, run.space(), tmp_path / "longer.rrd").ok
    clip(tmp_path / "longer.rrd", tmp_path / "clip.rrd", 0.1, 0.2)
    for name in ("run", "longer", "clip"):
        read = Recording.open(tmp_path / f"{name}.rrd")
        assert read.finished and read.frames > 2 and read.layout(), name
    assert replay(recording).same


def test_without_the_hook_of_layouts_a_stored_layout_is_left_out(
    run_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    stored = StoredLayout(Recording.open(run_file).layout())
    monkeypatch.delattr(rrb.Blueprint, "_log_to_stream")
    stream = stream_to(tmp_path / "copy.rrd")
    stream.log("a", rr.TextDocument("a"), static=True)
    send_layout(stream, APPLICATION, stored)
    stream.disconnect()
    assert chunks(tmp_path / "copy.rrd", RECORDING) and not chunks(tmp_path / "copy.rrd", BLUEPRINT)


def test_without_its_private_hook_a_notebook_viewer_gets_the_file_as_a_stream(run_file: Path, tmp_path: Path) -> None:
    class Other:
        def add_recording(self, stream: rr.RecordingStream) -> None:
            stream.set_sinks(rr.FileSink(tmp_path / "sent.rrd"))

    send_to_notebook(Other(), run_file.read_bytes())  # type: ignore[arg-type]
    paths = [{chunk.entity_path for chunk in chunks(file, RECORDING)} for file in (run_file, tmp_path / "sent.rrd")]
    assert "state/checkpoint" in paths[1] and paths[0] == paths[1]


@pytest.mark.parametrize("gone", ["rerun.experimental.ViewerClient", "rerun.experimental.ViewerClient.take_screenshot"])
def test_a_rerun_whose_viewer_cannot_be_driven_is_refused_in_a_sentence(
    gone: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delattr(gone)
    with pytest.raises(RecordingError, match=r"cannot render pictures .* pip install \"rerun-sdk==0\.41\.0\""):
        connect_viewer("rerun+http://127.0.0.1:9/proxy")


@pytest.mark.parametrize(
    ("at", "byte", "said"),
    [
        (3, 0x33, "in a newer format of .rrd than RRF2: upgrade carom"),
        (9, 3, "in a newer format of .rrd"),
        (5, 43, ""),
    ],
    ids=["format", "encoding of messages", "version of Rerun"],
)
def test_a_file_of_a_newer_rerun_opens_or_is_refused_in_a_sentence(
    at: int, byte: int, said: str, run_file: Path
) -> None:
    content = bytearray(run_file.read_bytes())
    content[at] = byte
    run_file.write_bytes(content)
    if said:
        with pytest.raises(RecordingError, match=said):
            Recording.open(run_file)
    else:
        assert Recording.open(run_file).frames > 0


def test_a_recording_is_stamped_with_the_rerun_that_wrote_it(tmp_path: Path) -> None:
    recording = carom.run(pair(time={"duration": 0.1, "max_dt": 0.05}), tmp_path / "run.rrd")
    assert recording.versions["rerun-sdk"] == rr.__version__
