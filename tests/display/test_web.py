"""A recording in a browser of this machine."""

from __future__ import annotations

import contextlib
import gzip
import html
import http.client
import mmap
import re
import socket
import subprocess
import time
import urllib.error
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Literal
from urllib.parse import urlsplit

import numpy as np
import psutil
import pytest
from numpy.typing import NDArray

import carom
from browser import LOADED, chromium, pixels_of, settled, wait_until_loaded
from carom.display import web
from carom.display.keeper import free_port
from carom.display.presentation import presentation
from carom.display.viewer import binary
from carom.display.web import Hosted, hosted
from carom.errors import RecordingError
from carom.recording.layout import LEGEND_SHARE
from carom.recording.read.recording import Recording
from carom.scene.load import Scene
from needs import BROWSER
from other_user import as_root, run_as_nobody
from page_requests import requests_of_pages

if TYPE_CHECKING:
    from playwright.sync_api import Page


@pytest.fixture(scope="module")
def link(recorded: Path) -> Iterator[str]:
    recording = Recording.open(recorded)
    with hosted(recording, 2.0, presentation(recording, 2.0).supplement) as page:
        yield page.link


def answer(link: str, name: str, host: str = "127.0.0.1") -> tuple[int, bytes]:
    """Ask the server for a file beside the page; return the status and the body."""
    parts = urlsplit(link)
    connection = http.client.HTTPConnection(str(parts.hostname), parts.port, timeout=60)
    try:
        connection.request("GET", parts.path.rpartition("/")[0] + "/" + name, headers={"Host": host})
        response = connection.getresponse()
        return response.status, response.read()
    finally:
        connection.close()


def listening() -> set[tuple[str, int]]:
    """Return where this process and its children listen."""
    me = psutil.Process()
    sockets = [socket for process in (me, *me.children(recursive=True)) for socket in process.net_connections("inet")]
    return {(socket.laddr.ip, socket.laddr.port) for socket in sockets if socket.status == psutil.CONN_LISTEN}


def test_a_hosted_recording_is_listened_for_on_loopback_only(recorded: Path) -> None:
    before = listening()
    with hosted(Recording.open(recorded), 0.0) as page:
        assert listening() - before == {("127.0.0.1", urlsplit(page.link).port)}
    assert listening() - before == set()


def test_the_page_comes_with_the_recording_its_layout_and_all_of_the_viewer(link: str, recorded: Path) -> None:
    assert answer(link, web.RECORDING) == (200, recorded.read_bytes())
    assert answer(link, "moment.rbl")[1].startswith(b"RRF") and answer(link, "moment.rrd")[1].startswith(b"RRF")
    assert gzip.decompress(answer(link, "re_viewer.wasm.gz")[1]).startswith(b"\0asm")
    assert b"<title>A merry-go-round</title>" in answer(link, web.PAGE)[1]
    for name in web.FILES:
        assert answer(link, name)[0] == 200


def test_the_viewer_of_a_page_comes_from_the_installed_package_and_through_no_port(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise AssertionError("another user may have taken the port before")

    monkeypatch.setattr(socket.socket, "connect", refuse)
    monkeypatch.setattr(subprocess, "Popen", refuse)
    web._copy_web_viewer(tmp_path)
    script = (tmp_path / "re_viewer.js").read_bytes()
    code = gzip.decompress((tmp_path / "re_viewer.wasm.gz").read_bytes())
    with Path(binary()).open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as program:
        assert program.find(script) > 0 and script.startswith(b"let wasm_bindgen") and b"class WebHandle" in script
        assert program.find(code) > 0 and code.startswith(b"\0asm")


@pytest.mark.slow
def test_the_viewer_of_a_page_is_the_one_that_rerun_serves(tmp_path: Path) -> None:
    web._copy_web_viewer(tmp_path)
    served = {}
    command = [binary(), "--serve-web", "--bind", "127.0.0.1", "--web-viewer-port", str(free_port())]
    with subprocess.Popen([*command, "http://127.0.0.1/none.rrd"], stderr=subprocess.DEVNULL) as process:
        try:
            for name in ("re_viewer.js", "re_viewer_bg.wasm"):
                served[name] = downloaded(f"http://127.0.0.1:{command[-1]}/{name}")
        finally:
            process.kill()
    assert served["re_viewer.js"] == (tmp_path / "re_viewer.js").read_bytes()
    assert served["re_viewer_bg.wasm"] == gzip.decompress((tmp_path / "re_viewer.wasm.gz").read_bytes())


def downloaded(address: str) -> bytes:
    """Download a file of a server that is starting."""
    for _ in range(300):
        with contextlib.suppress(ConnectionRefusedError):
            parts = urlsplit(address)
            connection = http.client.HTTPConnection(str(parts.hostname), parts.port, timeout=60)
            connection.request("GET", parts.path)
            return connection.getresponse().read()
        time.sleep(0.1)
    raise AssertionError("the server did not start")


def test_the_link_pauses_at_the_moment_in_nanoseconds(link: str) -> None:
    assert urlsplit(link).fragment == "at=2000000000&show=moment"


@pytest.mark.parametrize(
    "name", ["", "no-such-file", "../recording.rrd", "../../../../etc/passwd", "%2e%2e/viewer.html"]
)
def test_only_the_files_of_the_page_are_served(link: str, name: str) -> None:
    assert answer(link, name)[0] == 404


def test_nothing_is_served_without_the_secret_of_the_link(link: str) -> None:
    secret = urlsplit(link).path.split("/")[1]
    assert len(secret) >= 20
    assert answer(link.replace(secret, "x" * len(secret)), web.PAGE)[0] == 404


@pytest.fixture
def unfinished(recorded: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Hosted]:
    """A hosted page without the viewer, which takes seconds to copy."""
    monkeypatch.setattr(web, "_copy_web_viewer", lambda folder: None)
    with hosted(Recording.open(recorded), 1.0) as page:
        yield page


def test_the_command_line_of_a_browser_has_no_secret_and_leads_to_the_link(unfinished: Hosted) -> None:
    assert urlsplit(unfinished.link).path.split("/")[1] not in unfinished.command_line
    with pytest.raises(urllib.error.HTTPError) as led:
        urllib.request.build_opener(NoRedirect).open(unfinished.command_line, timeout=60)
    assert led.value.status == 303 and led.value.headers["Location"] == unfinished.link


class NoRedirect(urllib.request.HTTPRedirectHandler):
    def redirect_request(self, *_: object) -> None:
        return None


@as_root
def test_the_command_line_of_a_browser_leads_another_user_nowhere(unfinished: Hosted) -> None:
    parts = urlsplit(unfinished.command_line)
    answer = run_as_nobody(f"""
connection = socket.create_connection(("127.0.0.1", {parts.port}), timeout=60)
connection.sendall(b"GET {parts.path} HTTP/1.1\\r\\nHost: 127.0.0.1\\r\\nConnection: close\\r\\n\\r\\n")
print(connection.makefile("rb").read())
""")
    assert answer.startswith("b'HTTP/1.1 404 ") and unfinished.link not in answer


def test_where_users_cannot_be_told_apart_a_private_file_leads_to_the_link(
    recorded: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(web, "_copy_web_viewer", lambda folder: None)
    monkeypatch.setattr(web, "is_ours", lambda *_: False)
    with hosted(Recording.open(recorded), 1.0) as page:
        file = Path(urlsplit(page.command_line).path)
        assert file.parent.stat().st_mode & 0o077 == 0
        assert html.unescape(file.read_text()).count(page.link) == 1
    assert not file.exists()


def test_a_page_of_another_name_that_leads_here_is_refused(unfinished: Hosted) -> None:
    link = unfinished.link
    parts = urlsplit(link)
    port, ours = parts.port or 0, re.compile(rb"Host: (evil@)?(127\.0\.0\.1|localhost)(:\d+)?\r", re.IGNORECASE)
    for path in ("/", parts.path):
        for request in requests_of_pages(port, path)[::3]:
            with socket.create_connection(("127.0.0.1", port), timeout=60) as connection:
                connection.sendall(request)
                connection.shutdown(socket.SHUT_WR)
                with contextlib.suppress(ConnectionResetError):
                    if connection.recv(12) == b"HTTP/1.1 200":
                        assert path == parts.path and ours.search(request), request
    assert answer(link, web.PAGE, "evil.example")[0] == 403
    assert answer(link, web.PAGE, "localhost:8000")[0] == 200


def test_a_port_in_use_is_named(recorded: Path, link: str) -> None:
    taken = urlsplit(link).port or 0
    with (
        pytest.raises(RecordingError, match=f"port {taken} is in use"),
        hosted(Recording.open(recorded), 0.0, port=taken),
    ):
        pass


@pytest.mark.nightly
@pytest.mark.slow
@pytest.mark.needs(BROWSER)
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_a_browser_shows_the_recording_paused_at_the_moment_of_the_link(
    link: str, scheme: Literal["light", "dark"]
) -> None:
    with chromium(1280, 720) as (page, errors):
        page.emulate_media(color_scheme=scheme)
        page.goto(link)
        wait_until_loaded(page, errors)
        first, second = settled(page), pixels_of(page)
        page.goto(link.replace("at=2000000000", "at=3000000000"))
        page.wait_for_selector("body:not([data-state])", state="attached", timeout=LOADED)
        wait_until_loaded(page, errors)
        later = settled(page)
    assert not errors
    height, width, _ = first.shape
    bodies = (slice(int(0.15 * height), int(0.5 * height)), slice(0, int(0.55 * width)))
    assert np.median(first[bodies].sum(axis=2)) < 100, "the ground is dark"
    legend_is_whole(first)
    assert np.mean(np.ptp(first[bodies], axis=2) > 60) > 0.05, "bodies in the colours of their groups"
    assert np.array_equal(first[bodies], second[bodies]), "paused"
    assert np.mean(np.any(first[bodies] != later[bodies], axis=2)) > 0.05, "another moment"


def legend_is_whole(pixels: NDArray[np.int64]) -> None:
    """Check that the words of a legend stand out, and that none is cut; ``pixels`` are those of the page."""
    height, width, _ = pixels.shape
    legend = pixels[70 : height - 40, int((1.0 - LEGEND_SHARE) * width) + 3 : width - 2]
    label = np.abs(legend - [0x1B, 0x1D, 0x20]).max(axis=2) < 8
    rows = np.flatnonzero(label.mean(axis=1) > 0.3)
    lines = np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1)
    assert len(lines) >= 5, "each line has its label"
    linear = (legend / 255) ** 2.2 @ [0.2126, 0.7152, 0.0722]
    for line in lines:
        brightest = linear[line[0] : line[-1] + 1].max()
        assert (brightest + 0.05) / (0.0123 + 0.05) > 4.5, "the contrast to the label, of luminance 0.0123"
    assert linear[:, :3].max() < 0.1 and linear[:, -3:].max() < 0.1, "no word reaches an edge"


@pytest.mark.nightly
@pytest.mark.slow
@pytest.mark.needs(BROWSER)
def test_arrow_keys_step_from_impact_to_impact(tmp_path: Path) -> None:
    recording = carom.run(Scene.load("rack-break", ["time.duration=0.05"]), tmp_path / "run.rrd")
    at = recording.impacts()["time"][0].as_py()
    with hosted(recording, at, presentation(recording, at).supplement) as hosting, chromium() as (page, errors):
        page.goto(hosting.link)
        wait_until_loaded(page, errors)
        moment = settled(page)
        choose_the_timeline_of_impacts(page)
        pictures = [settled(page)]
        for key in ("ArrowRight", "ArrowRight", "ArrowLeft"):
            page.keyboard.press(key)
            pictures.append(settled(page))
    assert not errors
    height, width, _ = moment.shape
    plots = (slice(int(0.57 * height), int(0.76 * height)), slice(None))
    assert np.ptp(moment[plots], axis=2).max() > 60, "curves over time"
    assert not np.array_equal(pictures[0][plots], moment[plots]), "energies over the numbers of impacts"
    first, second, third, again = (picture[int(0.15 * height) : height // 2, : width // 2] for picture in pictures)
    assert not np.array_equal(first, second) and not np.array_equal(second, third)
    assert np.array_equal(second, again), "back at the second impact"


def choose_the_timeline_of_impacts(page: Page) -> None:
    """Choose `impact` in the menu of the time panel, at the top of three entries. The viewer is one canvas."""
    assert page.viewport_size is not None
    bottom = page.viewport_size["height"]
    for up in (14, 90):
        page.mouse.click(183, bottom - up)
        page.wait_for_timeout(2000)
