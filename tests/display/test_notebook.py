"""The example notebook, and recordings that are shown in notebooks."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

import carom
from carom.display import notebook
from carom.errors import RecordingError
from carom.recording.read.recording import Recording
from carom.recording.write.recorder import FrameRecorder
from scripted_run import ScriptedRun

DOCS = Path(__file__).parents[2] / "docs"
NOTEBOOKS = ("notebook.ipynb", "lesson.ipynb")
LARGEST = 20_000  # bytes


def read(name: str) -> Any:
    import nbformat

    reader: Any = nbformat  # untyped
    return reader.read(DOCS / name, as_version=4)


class SpyViewer:
    """Stands for the viewer of a notebook."""

    def __init__(self, **options: Any) -> None:
        self.options = options
        self.displayed = False
        self.files: list[bytes] = []
        self.times: list[dict[str, Any]] = []
        self.callbacks: list[Any] = []

    def on_event(self, callback: Any) -> None:
        self.callbacks.append(callback)

    def display(self) -> None:
        self.displayed = True

    def set_time_ctrl(self, **time: Any) -> None:
        self.times.append(time)

    def _flush_hook(self, data: bytes) -> None:
        self.files.append(data)


@pytest.fixture
def viewers(monkeypatch: pytest.MonkeyPatch) -> list[SpyViewer]:
    made: list[SpyViewer] = []

    def make(**options: Any) -> SpyViewer:
        made.append(SpyViewer(**options))
        return made[-1]

    monkeypatch.setattr(notebook, "Viewer", make)
    return made


@pytest.fixture
def recording(tmp_path: Path) -> Recording:
    path, scripted = tmp_path / "run.rrd", ScriptedRun(5)
    with FrameRecorder(path, scripted.header) as recorder:
        for frame in scripted.frames(5):
            recorder.put(frame)
        recorder.finish("completed")
    return Recording.open(path)


def test_a_notebook_gets_the_recording_and_pauses_at_the_moment(recording: Recording, viewers: list[SpyViewer]) -> None:
    carom.show(recording, at=0.1, height=321)
    (viewer,) = viewers
    assert viewer.displayed and viewer.options["height"] == 321
    assert viewer.files[0] == recording.path.read_bytes() and len(viewer.files) == 2
    assert viewer.times[-1]["play"] is False and viewer.times[-1]["duration"].item() == 100_000_000


def test_a_moment_that_is_not_in_the_recording_displays_nothing(recording: Recording, viewers: list[SpyViewer]) -> None:
    with pytest.raises(RecordingError, match="99 s is outside"):
        carom.show(recording, at=99.0)
    assert not viewers


def test_without_the_extra_one_sentence_names_it(recording: Recording, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rerun.notebook.HAS_NOTEBOOK", False)
    with pytest.raises(RecordingError, match=r"pip install 'rerun-sdk\[notebook\]"):
        carom.show(recording)


@pytest.mark.needs("nbclient")
@pytest.mark.parametrize("name", NOTEBOOKS)
def test_a_notebook_of_the_docs_is_small_and_was_executed(name: str) -> None:
    book = read(name)
    assert (DOCS / name).stat().st_size < LARGEST
    numbers = [cell.execution_count for cell in book.cells if cell.cell_type == "code"]
    assert numbers == list(range(1, len(numbers) + 1))


@pytest.mark.slow
@pytest.mark.needs("nbclient")
@pytest.mark.parametrize("name", NOTEBOOKS)
def test_a_notebook_of_the_docs_runs_and_prints_what_it_shows(name: str, tmp_path: Path) -> None:
    shown = read(name)
    run = read(name)
    where = {"metadata": {"path": str(tmp_path)}}
    from nbclient import NotebookClient

    NotebookClient(run, timeout=300, kernel_name="python3", store_widget_state=False, resources=where).execute()
    assert [results(cell) for cell in run.cells] == [results(cell) for cell in shown.cells]
    shows = any("carom.show(" in cell["source"] for cell in run.cells)
    assert any("Viewer" in str(cell.get("outputs")) for cell in run.cells) == shows, "the viewer is displayed"


def results(cell: Any) -> list[str]:
    """Return the results of a cell; what is displayed is not among them."""
    outputs = cell.get("outputs", [])
    return [output["data"]["text/plain"] for output in outputs if output["output_type"] == "execute_result"]
