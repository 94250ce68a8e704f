"""`carom view --web`: what a person reads."""

from __future__ import annotations

import re
import socket
from pathlib import Path
from urllib.parse import urlsplit

import pytest

from carom.display import web
from carom.recording.write.recorder import FrameRecorder
from carom_command import carom
from scripted_run import ScriptedRun


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A recording, in a process that is interrupted as soon as it hosts it; the page is left out."""

    def interrupt(seconds: float) -> None:
        raise KeyboardInterrupt

    path, scripted = tmp_path / "run.rrd", ScriptedRun(3)
    with FrameRecorder(path, scripted.header) as recorder:
        for frame in scripted.frames(3):
            recorder.put(frame)
        recorder.finish("completed")
    monkeypatch.setattr(web, "write_viewer", lambda recording, folder: None)
    monkeypatch.setattr("carom.cli.view.sleep", interrupt)
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "WAYLAND_SOCKET"):
        monkeypatch.delenv(name, raising=False)
    return path


def test_without_a_display_the_link_comes_with_the_tunnel_that_leads_to_it(run: Path) -> None:
    done = carom("view", "run.rrd", "--web", "--at", "0.05", cwd=run.parent)
    assert done.returncode == 0 and not done.stderr
    found = re.match(r"http://127\.0\.0\.1:(\d+)/[\w-]{20,}/viewer\.html#at=50000000&show=moment\n", done.stdout)
    assert found, done.stdout
    assert f"ssh -N -L {found[1]}:127.0.0.1:{found[1]} " in done.stdout


def test_with_a_display_the_browser_is_opened(run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    opened: list[str] = []

    def open_browser(link: str) -> bool:
        opened.append(link)
        return True

    monkeypatch.setenv("DISPLAY", ":99")
    monkeypatch.setattr("webbrowser.open", open_browser)
    done = carom("view", "run.rrd", "--web", cwd=run.parent)
    assert "ssh" not in done.stdout and not done.stderr
    link = done.stdout.splitlines()[0]
    assert urlsplit(link).netloc == urlsplit(opened[0]).netloc
    assert urlsplit(link).path.split("/")[1] not in opened[0], "every user can read the browser's command line"


def test_without_a_browser_one_sentence_says_what_to_do(run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("DISPLAY", ":99")
    monkeypatch.setattr("webbrowser.open", lambda link: False)
    done = carom("view", "run.rrd", "--web", cwd=run.parent)
    assert done.stderr == "No browser was found; open the link in a browser.\n"


def test_a_port_in_use_is_one_sentence_with_the_remedy(run: Path) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = str(taken.getsockname()[1])
        done = carom("view", "run.rrd", "--web", "--port", port, cwd=run.parent)
    assert done.returncode == 2
    assert done.stderr == f"carom: port {port} is in use; name another, or leave it out\n"


def test_a_moment_that_is_not_in_the_recording_is_refused(run: Path) -> None:
    done = carom("view", "run.rrd", "--web", "--at", "99", cwd=run.parent)
    assert done.returncode == 2 and "99 s is outside" in done.stderr
