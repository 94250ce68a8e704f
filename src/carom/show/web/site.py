"""Writes the files of a page that shows a recording in Rerun's web viewer, and the index page of a published folder.

The pages make no requests to other hosts.
"""

from __future__ import annotations

import gzip
import html
import mmap
import shlex
import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from string import Template

from carom.errors import RecordingError
from carom.recording.edit.repair import new_layout
from carom.recording.read.recording import Recording
from carom.recording.schema.time_scale import TimeScale
from carom.recording.write.rerun_compat import StoredLayout
from carom.show.supplement import Supplement
from carom.show.viewer import binary

PAGE = "viewer.html"
RECORDING = "recording.rrd"
LAYOUT = "layout.rbl"
NOTICES = "THIRD_PARTY_NOTICES.md"
FILES = (PAGE, "viewer.css", "viewer.js", "re_viewer.js", "re_viewer.wasm.gz", LAYOUT, NOTICES)  # and the recording

_LEVEL = 4  # 43 MB become 14.3 MB in 1.0 s; level 6: 13.8 MB in 2.0 s. Some static hosts refuse files above 25 MB
_SCRIPT_STARTS, _SCRIPT_ENDS = b"let wasm_bindgen = (function(exports)", b"})({ __proto__: null });\n"
_MODULE_STARTS = b"\0asm\x01\0\0\0"
_LAST_SECTION = 13
_NO_WEB_VIEWER = "the installed rerun-sdk holds no web viewer that carom can read; install the version that carom names"


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
    return f"{PAGE}#at={TimeScale(float(recording.info['time_scale'])).nanoseconds([at])[0]}"


def _copy_web_viewer(folder: Path) -> None:
    """Copy the web viewer out of Rerun's binary.

    The binary also serves it, but from a port that another user may have taken before.
    """
    with Path(binary()).open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as program:
        script, code = _script(program), _web_assembly(program)
        (folder / "re_viewer.js").write_bytes(program[script])
        with gzip.GzipFile(folder / "re_viewer.wasm.gz", "wb", _LEVEL, mtime=0) as packed:
            packed.write(program[code])


def _script(program: mmap.mmap) -> slice:
    """Return where a program holds the viewer's JavaScript."""
    start = program.find(_SCRIPT_STARTS)
    end = program.find(_SCRIPT_ENDS, start)
    if start < 0 or end < 0:
        raise RecordingError(_NO_WEB_VIEWER)
    return slice(start, end + len(_SCRIPT_ENDS))


def _web_assembly(program: mmap.mmap) -> slice:
    """Return where a program holds a module of WebAssembly: a header, and sections with their sizes."""
    start = program.find(_MODULE_STARTS)
    if start < 0:
        raise RecordingError(_NO_WEB_VIEWER)
    end = start + len(_MODULE_STARTS)
    while program[end] <= _LAST_SECTION:
        size = shift = 0
        place = end + 1
        while True:  # LEB128: seven bits a byte, the lowest first
            byte = program[place]
            size |= (byte & 127) << shift
            place, shift = place + 1, shift + 7
            if byte < 128:
                break
        if size == 0:  # padding
            break
        end = place + size
    return slice(start, end)


INDEX, STYLE = "index.html", "index.css"


@dataclass(frozen=True, slots=True)
class Figure:
    """A moment on the page."""

    lines: Sequence[str]  # its description
    link: str  # to the viewer, paused at the moment
    picture: str  # name of its file; empty without one


def write_index(
    folder: Path, title: str, name: str, rows: Sequence[tuple[str, str]], figures: Sequence[Figure]
) -> None:
    """Write the page and its style into a folder that has the recording.

    Parameters
    ----------
    folder
        The folder of the recording and the viewer.
    title
        Of the scene.
    name
        File name of the recording when it is downloaded.
    rows
        Names and texts of a table.
    figures
        The moments.
    """
    page = resources.files(__package__) / "page"
    size = (folder / "recording.rrd").stat().st_size
    text = Template((page / INDEX).read_text(encoding="utf-8")).substitute(
        title=html.escape(title),
        file=html.escape(name),
        quoted=html.escape(shlex.quote(name)),
        size=f"{size / 1e6:.3g} MB",
        rows="\n".join(f"      <tr><th>{html.escape(row)}</th><td>{html.escape(text)}</td></tr>" for row, text in rows),
        moments="\n".join(map(_figure, figures)),
    )
    (folder / INDEX).write_text(text, encoding="utf-8")
    (folder / STYLE).write_bytes((page / STYLE).read_bytes())


def _figure(figure: Figure) -> str:
    link = html.escape(figure.link)
    lines = "".join(f"<p>{html.escape(line)}</p>" for line in figure.lines)
    alt = html.escape(figure.lines[0])
    picture = f'<img src="{html.escape(figure.picture)}" alt="{alt}" width="1600" height="1000" />'
    shown = picture if figure.picture else "Open this moment in the viewer"
    return f'      <figure><a href="{link}">{shown}</a><figcaption>{lines}</figcaption></figure>'
