"""Writes the files of a page that shows a recording in Rerun's web viewer, without requests to other hosts."""

from __future__ import annotations

import gzip
import html
import http.client
import shutil
import subprocess
import time
from importlib import resources
from pathlib import Path

from carom.recording.edit.restored_blueprint import new_layout
from carom.recording.errors import RecordingError
from carom.recording.read.recording import Recording
from carom.recording.schema.clock import Clock
from carom.recording.view.supplement import Supplement
from carom.recording.view.viewer import HOST, binary, free_port
from carom.recording.write.rerun_compat import StoredLayout

PAGE = "viewer.html"
RECORDING = "recording.rrd"
LAYOUT = "layout.rbl"
NOTICES = "THIRD_PARTY_NOTICES.md"
FILES = (PAGE, "viewer.css", "viewer.js", "re_viewer.js", "re_viewer.wasm.gz", LAYOUT, NOTICES)  # and the recording

_SERVED = {"re_viewer.js": "re_viewer.js", "re_viewer_bg.wasm": "re_viewer.wasm.gz"}
_LEVEL = 4  # 43 MB become 14.3 MB in 1.0 s; level 6: 13.8 MB in 2.0 s. Some static hosts refuse files above 25 MB
_START = 60.0  # s
_POLL = 0.05  # s


def write_viewer(recording: Recording, folder: Path) -> None:
    """Write `FILES` into a folder; the recording is expected beside them as `RECORDING`.

    RecordingError if the installed Rerun has no web viewer; OSError if the folder cannot be written.
    """
    page = resources.files(__package__) / "page"
    text = (page / PAGE).read_text(encoding="utf-8")
    title = f"<title>{html.escape(recording.title)}</title>"
    (folder / PAGE).write_text(text.replace("<title>carom</title>", title), encoding="utf-8")
    for name in ("viewer.css", "viewer.js"):
        (folder / name).write_bytes((page / name).read_bytes())
    chunks = recording.layout()
    layout = StoredLayout(chunks) if chunks else new_layout(recording)
    layout.save(recording.store.application_id, folder / LAYOUT)
    _copy_web_viewer(folder)
    shutil.copyfile(Path(binary()).with_name(NOTICES), folder / NOTICES)


def write_moment(recording: Recording, at: float, supplement: Supplement, folder: Path, name: str) -> str:
    """Write the files of a time (s), ``NAME.rbl`` and ``NAME.rrd``; return the page's address, paused there."""
    application, recording_id = recording.store.application_id, recording.store.store_id
    supplement.layout.save(application, folder / f"{name}.rbl")
    supplement.save(folder / f"{name}.rrd", application, recording_id)
    return f"{paused_page(recording, at)}&show={name}"


def paused_page(recording: Recording, at: float) -> str:
    """Return the address of the page, relative to its folder, paused at a time (s) in the recording's own layout."""
    return f"{PAGE}#at={Clock(float(recording.info['time_scale'])).nanoseconds([at])[0]}"


def _copy_web_viewer(folder: Path) -> None:
    """Copy the web viewer out of Rerun's binary, which offers it only through its own web server."""
    port = free_port()
    # with an address to show, it hosts only the web viewer and no server for recordings
    command = [binary(), "--serve-web", "--bind", HOST, "--web-viewer-port", str(port), f"http://{HOST}/none.rrd"]
    process = subprocess.Popen(
        command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True
    )
    try:
        _wait_for(process, port)
        for served, name in _SERVED.items():
            _copy(port, served, folder / name)
    finally:
        process.kill()
        process.wait()


def _wait_for(process: subprocess.Popen[bytes], port: int) -> None:
    end = time.monotonic() + _START
    while True:
        connection = http.client.HTTPConnection(HOST, port, timeout=_START)
        try:
            connection.connect()
            return
        except ConnectionRefusedError:
            if process.poll() is not None or time.monotonic() > end:
                raise RecordingError("the installed rerun-sdk serves no web viewer") from None
            time.sleep(_POLL)
        finally:
            connection.close()


def _copy(port: int, served: str, path: Path) -> None:
    connection = http.client.HTTPConnection(HOST, port, timeout=_START)
    try:
        connection.request("GET", f"/{served}")
        response = connection.getresponse()
        if response.status != http.client.OK:
            raise RecordingError(f"the installed rerun-sdk has a web viewer without {served}")
        packed = gzip.GzipFile(path, "wb", _LEVEL, mtime=0) if path.suffix == ".gz" else path.open("wb")
        with packed as file:
            shutil.copyfileobj(response, file)
    except http.client.HTTPException as error:
        raise RecordingError(f"the web viewer of rerun-sdk could not be read: {error}") from error
    finally:
        connection.close()
