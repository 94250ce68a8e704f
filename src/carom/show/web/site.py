"""Writes the files of a page that shows recordings in Rerun's web viewer. It makes no requests to other hosts."""

from __future__ import annotations

import gzip
import html
import mmap
import shutil
from dataclasses import dataclass
from importlib import resources
from pathlib import Path

from carom.errors import RecordingError
from carom.recording.edit.repair import new_layout
from carom.recording.read.recording import Recording
from carom.recording.schema.header import TimeScale
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


@dataclass(frozen=True, slots=True)
class PageNames:
    """The names of a recording's files in a folder.

    Parameters
    ----------
    stem
        Begins the names of a recording's files: letters, digits and hyphens; empty if there is one recording only.
    """

    stem: str = ""

    @property
    def page(self) -> str:
        """The page about the recording."""
        return f"{self.stem or 'index'}.html"

    @property
    def recording(self) -> str:
        """The recording."""
        return f"{self.stem}.rrd" if self.stem else RECORDING

    @property
    def layout(self) -> str:
        """The layout in which the viewer shows it."""
        return f"{self.stem}.rbl" if self.stem else LAYOUT

    def moment(self, number: int) -> str:
        """Return the stem of the files of a moment. No stem of a recording has an underscore."""
        return f"{self.stem}_{number}" if self.stem else f"moment-{number}"

    def viewer(self, recording: Recording, at: float | None = None, show: str = "") -> str:
        """Return the address of the viewer, paused at a time (s), with what is shown of a moment."""
        at_ns = None if at is None else TimeScale(float(recording.info["time_scale"])).nanoseconds([at])[0]
        given = {"of": self.stem or None, "at": at_ns, "show": show or None}
        asked = "&".join(f"{key}={value}" for key, value in given.items() if value is not None)
        return f"{PAGE}#{asked}" if asked else PAGE


ONLY = PageNames()


def write_viewer(folder: Path, title: str) -> None:
    """Write the viewer and its page into a folder; layouts and recordings are expected beside them.

    RecordingError if the installed Rerun has no web viewer; OSError if the folder cannot be written.
    """
    page = resources.files(__package__) / "page"
    text = (page / PAGE).read_text(encoding="utf-8")
    text = text.replace("<title>carom</title>", f"<title>{html.escape(title)}</title>")
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
