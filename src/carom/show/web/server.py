"""Hosts the viewer and one recording for browsers of this machine only."""

from __future__ import annotations

import contextlib
import errno
import html
import secrets
import shutil
import socket
import socketserver
import threading
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from urllib.parse import urlsplit

from carom.errors import RecordingError
from carom.private_folder import temporary_folder
from carom.recording.read.recording import Recording
from carom.show.keeper import HOST, is_ours
from carom.show.supplement import Supplement
from carom.show.web import site

_NAMES = (HOST, "localhost")  # hosts that requests may name; others come from pages that were rebound to 127.0.0.1
_TYPES = {".html": "text/html; charset=utf-8", ".css": "text/css", ".js": "text/javascript"}


@dataclass(frozen=True, slots=True)
class Hosted:
    """The addresses of a page.

    Attributes
    ----------
    link
        An address that contains a secret: whoever knows it can open the recording.
    command_line
        An address without the secret, for a browser's command line, which other users can read. It leads this user, and
        nobody else, to `link`.
    """

    link: str
    command_line: str


@contextlib.contextmanager
def hosted(recording: Recording, at: float, supplement: Supplement | None = None, port: int = 0) -> Iterator[Hosted]:
    """Host a recording while the context lasts; yield the addresses that open it.

    The server listens on 127.0.0.1 only. The link has a secret in its path, since other people may use the machine.

    Parameters
    ----------
    recording
        The recording to show.
    at
        s, at which it is paused.
    supplement
        How to show that moment; by default in the recorded layout.
    port
        0 takes a free one.

    Raises
    ------
    RecordingError
        If the port is in use.
    """
    with temporary_folder() as folder, _listening(port) as server:
        site.write_viewer(folder, recording.title)
        site.write_layout(recording, folder / site.LAYOUT)
        shown = "" if supplement is None else "moment"
        if supplement is not None:
            site.write_moment(recording, supplement, folder, shown)
        page = site.ONLY.viewer(recording, at, shown)
        secret, entrance = secrets.token_urlsafe(16), secrets.token_urlsafe(16)
        files = {path.name: path for path in folder.iterdir()} | {site.RECORDING: recording.path.resolve()}
        server.files = {f"/{secret}/{name}": path for name, path in files.items()}
        here = f"http://{HOST}:{server.server_port}"
        link = f"{here}/{secret}/{page}"
        server.entrance, server.link = f"/{entrance}", link
        thread = threading.Thread(target=server.serve_forever, name="carom-web", daemon=True)
        thread.start()
        try:
            yield Hosted(link, f"{here}/{entrance}" if server.knows_us() else _redirection(folder, link))
        finally:
            server.shutdown()
            thread.join()


def _redirection(folder: Path, link: str) -> str:
    """Write a page that leads to a link, in a folder of this user; return its address."""
    page = folder / "open.html"
    page.write_text(f'<meta http-equiv="refresh" content="0; url={html.escape(link)}" />', encoding="utf-8")
    return page.as_uri()


class _Server(ThreadingHTTPServer):
    """Serves files by their paths."""

    daemon_threads = True
    files: Mapping[str, Path] = {}
    entrance = ""  # a path from which connections of this user are led to the link
    link = ""

    def knows_us(self, peer: tuple[str, int] | None = None) -> bool:
        """Return whether a connection, by default a new one of this process, is known to be of this user."""
        here = (HOST, self.server_port)
        if peer is not None:
            return is_ours(peer, here)
        with socket.create_connection(here) as ours:
            return is_ours(ours.getsockname(), here)

    def server_bind(self) -> None:
        """Bind without HTTPServer's look-up of the host's name, which takes seconds if there is no name server."""
        socketserver.TCPServer.server_bind(self)
        self.server_name, self.server_port = HOST, int(self.server_address[1])

    def handle_error(self, request: object, client_address: object) -> None:
        """Ignore errors: a browser may stop reading in the middle of a file."""


class _Handler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"
    server: _Server

    def do_GET(self) -> None:
        """Send a file."""
        self._answer(with_body=True)

    def do_HEAD(self) -> None:
        """Send the headers of a file."""
        self._answer(with_body=False)

    def log_message(self, format: str, *args: object) -> None:
        """Log nothing."""

    def _answer(self, with_body: bool) -> None:
        if urlsplit(f"//{self.headers.get('Host', '')}").hostname not in _NAMES:
            self.send_error(HTTPStatus.FORBIDDEN)
            return
        if self.path == self.server.entrance and self.server.knows_us(self.client_address):
            self.send_response(HTTPStatus.SEE_OTHER)
            self.send_header("Location", self.server.link)
            self.send_header("Content-Length", "0")
            self.send_header("Cache-Control", "no-store")
            self.end_headers()
            return
        path = self.server.files.get(urlsplit(self.path).path)
        try:
            file = path.open("rb") if path else None
        except OSError:
            file = None
        if path is None or file is None:
            self.send_error(HTTPStatus.NOT_FOUND)
            return
        with file:
            self.send_response(HTTPStatus.OK)
            self.send_header("Content-Type", _TYPES.get(path.suffix, "application/octet-stream"))
            self.send_header("Content-Length", str(path.stat().st_size))
            self.send_header("Cache-Control", "no-store")
            self.send_header("X-Content-Type-Options", "nosniff")
            self.send_header("Cross-Origin-Resource-Policy", "same-origin")
            self.end_headers()
            if with_body:
                shutil.copyfileobj(file, self.wfile)


def _listening(port: int) -> _Server:
    try:
        return _Server((HOST, port), _Handler)
    except OSError as error:
        if error.errno == errno.EADDRINUSE:
            raise RecordingError(f"port {port} is in use; name another, or leave it out") from None
        raise RecordingError(f"cannot listen on port {port}: {error.strerror}") from None
