"""Web pages: Rerun's web viewer for recordings, a server for browsers of this machine only, and published folders.

A published folder has a page about each recording, and an index page with a card for each. No page makes requests to
other hosts.
"""

from __future__ import annotations

import contextlib
import errno
import gzip
import mmap
import secrets
import shutil
import socket
import socketserver
import threading
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib import resources
from pathlib import Path
from string import Template
from urllib.parse import urlsplit

from carom.display.keeper import HOST, is_ours
from carom.display.supplement import Supplement
from carom.display.viewer import binary
from carom.errors import RecordingError
from carom.private_folder import temporary_folder
from carom.recording.edit.repair import new_layout
from carom.recording.read.recording import Recording
from carom.recording.schema.header import TimeScale
from carom.recording.write.rerun_compat import StoredLayout
from carom.scene.wording import command, hypertext

PAGE = "viewer.html"
RECORDING = "recording.rrd"
LAYOUT = "layout.rbl"
NOTICES = "THIRD_PARTY_NOTICES.md"
# files of a page, besides the recording
FILES = (PAGE, "viewer.css", "viewer.js", "re_viewer.js", "re_viewer.wasm.gz", LAYOUT, NOTICES)

# level of compression: 43 MB become 14.3 MB in 1.0 s; with level 6, 13.8 MB in 2.0 s. Some static hosts refuse files
# above 25 MB
_LEVEL = 4
_SCRIPT_STARTS, _SCRIPT_ENDS = b"let wasm_bindgen = (function(exports)", b"})({ __proto__: null });\n"
_MODULE_STARTS = b"\0asm\x01\0\0\0"
_LAST_SECTION = 13
_NO_WEB_VIEWER = (
    "the installed rerun-sdk contains no web viewer that carom can read; install the version that carom names"
)
_NAMES = (HOST, "localhost")  # hosts that requests may name; other names come from pages that use DNS rebinding
_TYPES = {".html": "text/html; charset=utf-8", ".css": "text/css", ".js": "text/javascript"}


@dataclass(frozen=True, slots=True)
class PageNames:
    """The names of a recording's files in a folder."""

    stem: str = ""  # first part of the names: letters, digits and hyphens; empty if there is only one recording

    @property
    def page(self) -> str:
        """Name of the page about the recording."""
        return f"{self.stem or 'index'}.html"

    @property
    def recording(self) -> str:
        """Name of the recording."""
        return f"{self.stem}.rrd" if self.stem else RECORDING

    @property
    def layout(self) -> str:
        """Name of the layout in which the viewer shows the recording."""
        return f"{self.stem}.rbl" if self.stem else LAYOUT

    def moment(self, number: int) -> str:
        """Return the stem of the files of a moment. No stem of a recording has an underscore."""
        return f"{self.stem}_{number}" if self.stem else f"moment-{number}"

    def viewer(self, recording: Recording, at: float | None = None, show: str = "") -> str:
        """Return the address of the viewer, paused at a time (s), with the name of a moment to show."""
        at_ns = None if at is None else TimeScale(float(recording.info["time_scale"])).nanoseconds([at])[0]
        given = {"of": self.stem or None, "at": at_ns, "show": show or None}
        asked = "&".join(f"{key}={value}" for key, value in given.items() if value is not None)
        return f"{PAGE}#{asked}" if asked else PAGE


ONLY = PageNames()


def write_viewer(folder: Path, title: str) -> None:
    """Write the viewer and its page into a folder; the viewer expects layouts and recordings beside this folder.

    Raises RecordingError if the installed Rerun has no web viewer, and OSError if the folder cannot be written.
    """
    page = resources.files(__package__) / "page"
    text = (page / PAGE).read_text(encoding="utf-8")
    text = text.replace("<title>carom</title>", f"<title>{hypertext(title)}</title>")
    (folder / PAGE).write_text(text, encoding="utf-8")
    for name in ("viewer.css", "viewer.js"):
        (folder / name).write_bytes((page / name).read_bytes())
    _copy_web_viewer(folder)
    shutil.copyfile(Path(binary()).with_name(NOTICES), folder / NOTICES)


def write_layout(recording: Recording, path: Path) -> None:
    """Write the layout in which a viewer shows a recording as a whole."""
    chunks = recording.layout()
    layout = StoredLayout(chunks) if chunks else new_layout(recording)
    layout.save(recording.store.application_id, path)


def write_moment(recording: Recording, supplement: Supplement, folder: Path, name: str) -> None:
    """Write the files of a moment, ``NAME.rbl`` and ``NAME.rrd``."""
    application, recording_id = recording.store.application_id, recording.store.store_id
    supplement.layout.save(application, folder / f"{name}.rbl")
    supplement.save(folder / f"{name}.rrd", application, recording_id)


def _copy_web_viewer(folder: Path) -> None:
    """Copy the web viewer out of Rerun's binary: Rerun's own server uses a port that another user may have taken."""
    with Path(binary()).open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as program:
        start = program.find(_SCRIPT_STARTS)
        end = program.find(_SCRIPT_ENDS, start)
        if start < 0 or end < 0:
            raise RecordingError(_NO_WEB_VIEWER)
        script, code = slice(start, end + len(_SCRIPT_ENDS)), _web_assembly(program)
        (folder / "re_viewer.js").write_bytes(program[script])
        with gzip.GzipFile(folder / "re_viewer.wasm.gz", "wb", _LEVEL, mtime=0) as packed:
            packed.write(program[code])


def _web_assembly(program: mmap.mmap) -> slice:
    """Return the place of a WebAssembly module in a program: a header, and sections with their sizes."""
    start = program.find(_MODULE_STARTS)
    if start < 0:
        raise RecordingError(_NO_WEB_VIEWER)
    end = start + len(_MODULE_STARTS)
    while program[end] <= _LAST_SECTION:
        size = shift = 0
        place = end + 1
        while True:  # LEB128: seven bits in each byte, the lowest first
            byte = program[place]
            size |= (byte & 127) << shift
            place, shift = place + 1, shift + 7
            if byte < 128:
                break
        if size == 0:  # padding
            break
        end = place + size
    return slice(start, end)


@dataclass(frozen=True, slots=True)
class Hosted:
    """The addresses of a page."""

    link: str  # contains a secret: whoever knows it can open the recording
    # address without the secret, which leads only this user to `link`: it is for a browser's command line, which other
    # users can read
    command_line: str


@contextlib.contextmanager
def hosted(recording: Recording, at: float, supplement: Supplement | None = None, port: int = 0) -> Iterator[Hosted]:
    """Host a recording, paused at a time (s), while the context lasts; yield the addresses that open it.

    The server listens on 127.0.0.1 only. The link has a secret in its path, since other people may use the machine.
    Without a ``supplement``, the recording is shown in its own layout. With ``port`` 0, the system chooses a free port.
    Raises RecordingError if the port is in use.
    """
    with temporary_folder() as folder, _listening(port) as server:
        write_viewer(folder, recording.title)
        write_layout(recording, folder / LAYOUT)
        shown = "" if supplement is None else "moment"
        if supplement is not None:
            write_moment(recording, supplement, folder, shown)
        page = ONLY.viewer(recording, at, shown)
        secret, entrance = secrets.token_urlsafe(16), secrets.token_urlsafe(16)
        files = {path.name: path for path in folder.iterdir()} | {RECORDING: recording.path.resolve()}
        server.files = {f"/{secret}/{name}": path for name, path in files.items()}
        here = f"http://{HOST}:{server.server_port}"
        link = f"{here}/{secret}/{page}"
        server.entrance, server.link = f"/{entrance}", link
        thread = threading.Thread(target=server.serve_forever, name="carom-web", daemon=True)
        thread.start()
        try:
            if server.knows_us():
                yield Hosted(link, f"{here}/{entrance}")
            else:  # a page in the private folder leads to the link
                redirection = folder / "open.html"
                refresh = f'<meta http-equiv="refresh" content="0; url={hypertext(link)}" />'
                redirection.write_text(refresh, encoding="utf-8")
                yield Hosted(link, redirection.as_uri())
        finally:
            server.shutdown()
            thread.join()


class _Server(ThreadingHTTPServer):
    """Serves files by their paths."""

    daemon_threads = True
    files: Mapping[str, Path] = {}
    entrance = ""  # path that redirects connections of this user to the link
    link = ""

    def knows_us(self, peer: tuple[str, int] | None = None) -> bool:
        """Return whether a connection, by default a new one of this process, is recognised as this user's."""
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


INDEX, STYLE = "index.html", "index.css"
SIZE = (1000, 640)  # pixels of a picture
NARROW_SIZE = (400, 520)  # pixels of a picture for phones, on which the words of the large picture would be too small
_NARROW = 520  # largest width (pixels) of a screen that gets the narrow picture
_FRAME = "frame.html"  # the template of a page, around the template of its content
_CLASS = "class.html"  # the template of the page with cards


@dataclass(frozen=True, slots=True)
class Figure:
    """A moment on the page."""

    heading: str
    details: Sequence[str]
    link: str  # link to the viewer, paused at the moment
    pictures: Sequence[str]  # names of the pictures' files


@dataclass(frozen=True, slots=True)
class About:
    """The content of a page about a recording."""

    title: str
    file: str  # name of the recording when it is downloaded
    recording: str  # name of the published file
    size: int  # bytes of the recording
    viewer: str  # address of the viewer
    problems: Sequence[str]  # problems of the run, and warnings
    description: str  # description of the scene
    headline: Sequence[tuple[str, str]]  # names and texts above the table
    rows: Sequence[tuple[str, str]]  # rows of a table: names and texts
    scene: str  # the scene file; empty if the recording has none
    figures: Sequence[Figure]
    energy: str  # name of the picture of the energy; empty if there is none
    missing: str  # why pictures are missing; empty if none is missing
    narrow: bool  # whether each picture has a version for phones, called `narrow_name`


@dataclass(frozen=True, slots=True)
class Card:
    """A recording on the page about several recordings."""

    page: str
    about: About
    picture: str  # name of the picture's file; empty without a picture


def narrow_name(name: str) -> str:
    """Return the name of the picture for phones, given the name of the large picture."""
    return f"{name.removesuffix('.png')}-narrow.png"


def write_page(path: Path, about: About, *, back: bool) -> None:
    """Write the page about a recording, with or without a link ``back`` to the page about all recordings."""
    viewer = hypertext(about.viewer)
    scene = f"<details><summary>Scene file</summary><pre>{hypertext(about.scene)}</pre></details>"
    paragraphs = (" ".join(part.split()) for part in about.description.split("\n\n"))
    _write(
        path,
        INDEX,
        title=hypertext(about.title),
        back=f'<p><a href="{INDEX}">← All recordings</a></p>' if back else "",
        problems=_problems(about.problems),
        description="".join(f"<p>{hypertext(each)}</p>" for each in paragraphs if each),
        headline=_headline(about.headline),
        viewer=viewer,
        recording=hypertext(about.recording),
        file=hypertext(about.file),
        replay=hypertext(command("replay", Path(about.file))),
        size=f"{about.size / 1e6:.3g} MB",
        missing=_missing(about.missing),
        moments="\n".join(_figure(figure, about.narrow) for figure in about.figures),
        energy=f"<h2>Energy</h2>{_image(about.energy, 'The energy over time', about.narrow)}" if about.energy else "",
        rows="\n".join(f"<tr><th>{hypertext(row)}</th><td>{hypertext(text)}</td></tr>" for row, text in about.rows),
        scene=scene if about.scene else "",
    )


def write_cards(folder: Path, title: str, cards: Sequence[Card]) -> None:
    """Write the page with a card for each recording."""
    missing = dict.fromkeys(card.about.missing for card in cards if card.about.missing)
    _write(
        folder / INDEX,
        _CLASS,
        title=hypertext(title),
        missing="".join(map(_missing, missing)),
        cards="\n".join(map(_card, cards)),
    )


def write_style(folder: Path) -> None:
    """Write the style of the pages."""
    (folder / STYLE).write_bytes((resources.files(__package__) / "page" / STYLE).read_bytes())


def _write(path: Path, template: str, title: str, **texts: str) -> None:
    """Write a page: the frame that all pages share, around the content of one page."""
    frame, content = (
        Template((resources.files(__package__) / "page" / name).read_text(encoding="utf-8"))
        for name in (_FRAME, template)
    )
    page = frame.substitute(title=title, content=content.substitute(texts, title=title))
    path.write_text(page, encoding="utf-8")


def _figure(figure: Figure, narrow: bool) -> str:
    link = hypertext(figure.link)
    texts = (figure.heading, f"{figure.heading}, close up")
    images = [_image(picture, text, narrow) for picture, text in zip(figure.pictures, texts, strict=False)]
    shown = [f'<a href="{link}">{image}</a>' for image in images or ["Open this moment in the viewer"]]
    names = zip(figure.pictures, ("bodies", "close up"), strict=False)
    whole = ", ".join(f'<a href="{hypertext(picture)}">{name}</a>' for picture, name in names)
    shown += [f'<p class="note">In full size: {whole}</p>'] if whole else []
    details = " · ".join(f"<span>{hypertext(detail)}</span>" for detail in figure.details)
    caption = f"<h2>{hypertext(figure.heading)}</h2><p>{details}</p>"
    return f'<figure><figcaption>{caption}</figcaption><div class="pictures">{"".join(shown)}</div></figure>'


def _card(card: Card) -> str:
    about, link = card.about, hypertext(card.page)
    picture = _image(card.picture, about.title, about.narrow) if card.picture else ""
    return (
        f'<article class="card"><a href="{link}">{picture}<h2>{hypertext(about.title)}</h2></a>'
        f"{_problems(about.problems[:1])}{_headline(about.headline)}"
        f'<p class="note">{hypertext(about.file)}</p></article>'
    )


def _image(name: str, alt: str, narrow: bool) -> str:
    (width, height), (thin, tall) = SIZE, NARROW_SIZE
    image = f'<img src="{hypertext(name)}" alt="{hypertext(alt)}" width="{width}" height="{height}" />'
    if not narrow:
        return image
    other = f'media="(max-width: {_NARROW}px)" srcset="{hypertext(narrow_name(name))}" width="{thin}" height="{tall}"'
    return f"<picture><source {other} />{image}</picture>"


def _problems(problems: Sequence[str]) -> str:
    items = "".join(f"<li>{hypertext(text)}</li>" for text in problems)
    return f'<ul class="problems">{items}</ul>' if problems else ""


def _headline(headline: Iterable[tuple[str, str]]) -> str:
    facts = (f"<div><dt>{hypertext(name)}</dt><dd>{hypertext(text)}</dd></div>" for name, text in headline)
    return f'<dl class="headline">{"".join(facts)}</dl>'


def _missing(reason: str) -> str:
    return f'<p class="note">Without pictures: {hypertext(reason)}</p>' if reason else ""
