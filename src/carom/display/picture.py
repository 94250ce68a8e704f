"""A picture of a recording, rendered without a screen."""

from __future__ import annotations

import os
import shutil
import struct
import tempfile
import time
import zlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import rerun as rr

from carom.display.letters import drawable
from carom.display.presentation import asked
from carom.display.request import Request
from carom.display.viewer import Viewer, virtual_screen
from carom.errors import RecordingError
from carom.private_folder import private_folder
from carom.recording.layout import ALL
from carom.recording.layout.canvas import Canvas
from carom.recording.read.lookup import names_of
from carom.recording.read.recording import Recording
from carom.recording.write.whole_file import whole_file


def has_all_glyphs(recording: Recording) -> bool:
    """Return whether the font has all characters of the names that a picture shows.

    These are the names of bodies and planes, in labels and events, and the name of the file; for an overlay, the names
    of its files.
    """
    if not drawable(recording.path.name):
        return False
    if recording.is_overlay:
        return all(drawable(str(text)) for text in recording.overlaid.values())
    names = names_of(recording)
    return all(map(drawable, (*names.bodies, *names.planes)))


_ALIKE = 3  # number of successive equal pictures after which everything is loaded
_PAUSE = 0.7  # s between two pictures
_LIMIT = 120.0  # s, time limit for a picture
_NOTE = 6.0  # s after its start during which a viewer with a window shows notes over the picture
_SETTINGS = '{{"egui": "(options:(theme_preference:{theme}))", "rerun.version": "{version}"}}'
_MARK = b"Software\x00carom picture"  # a text that marks each PNG
_HEAD = 33  # bytes of a PNG up to the end of its first chunk
_BORDER = (7, 71)  # points of a window around a single view, across and down: edges, title and title bar


@dataclass(frozen=True, slots=True)
class Picture:
    """The moment that a picture shows."""

    time: float  # s
    missing: str  # why the picture shows the previous frame instead of the requested step; empty if it shows the step


def render(
    path: str | Path,
    request: Request,
    out_png: str | Path,
    size: tuple[int, int] = (1600, 1000),
    *,
    view: str = ALL,
    theme: str = "dark",
) -> Picture:
    """Render a moment of a recording into a PNG.

    Parameters
    ----------
    size
        Width and height in pixels.
    view
        One view that fills the picture, or all views.
    theme
        Theme of the viewer and of all views, "dark" or "light".

    Raises
    ------
    RecordingError
        If the recording cannot be read, there is no Vulkan driver, or no Xvfb where one is needed, or a view has
        nothing to show.
    """
    recording, out = Recording.open(path), Path(out_png)
    # a file that cannot be written is refused before a minute of rendering
    if out.is_dir():
        raise RecordingError(f"cannot write {out}: it is a folder; name a file")
    if out.suffix.lower() != ".png":
        raise RecordingError(f"cannot write {out}: a picture is a .png")
    if not out.parent.is_dir():
        raise RecordingError(f"cannot write {out}: there is no folder {out.parent}")
    if not os.access(out if out.exists() else out.parent, os.W_OK):
        raise RecordingError(f"cannot write {out}: permission denied")
    whole = view == ALL or recording.is_overlay
    if recording.is_overlay:
        moment, extra, missing = recording.moment(request.at), None, ""
    else:
        canvas = Canvas(*size, framed=whole, rendered=True, theme=theme)
        shown = asked(recording, request, canvas, view)
        moment, extra, missing = shown.time, shown.supplement, shown.missing
    with headless(recording, window_of(size, whole), theme) as viewer:
        viewer.show(recording)
        viewer.go_to(recording, moment)
        if extra is not None:
            viewer.add(extra)
        _save(viewer, recording, None if whole else viewer.only_view(), out)
    return Picture(moment, missing)


@dataclass(frozen=True, slots=True)
class Shot:
    """One of several pictures of a recording."""

    request: Request
    view: str  # a single view
    out_png: Path


def try_to_render(recording: Recording, shots: Sequence[Shot], size: tuple[int, int] = (1000, 640)) -> str:
    """Render moments of a recording, in order of time, with one viewer.

    Return the reason if a picture fails, such as a missing driver; otherwise an empty text. Earlier pictures are kept.
    """
    canvas, last = Canvas(*size, framed=False, rendered=True), ""
    try:
        with headless(recording, window_of(size, whole=False), canvas.theme) as viewer:
            viewer.show(recording)
            for shot in shots:
                shown = asked(recording, shot.request, canvas, shot.view)
                viewer.go_to(recording, shown.time)
                viewer.add(shown.supplement)
                last = viewer.only_view(before=last)
                _save(viewer, recording, last, shot.out_png)
    except RecordingError as error:
        return str(error)
    return ""


def _save(viewer: Viewer, recording: Recording, view: str | None, out_png: Path) -> None:
    """Write a picture of a view, or of the whole window, once it is stable."""
    viewer.outlast_note()
    png = stable_picture(viewer, view)
    reports = [f"{one.name}: {report}" for one in viewer.client.get_state().views for report in one.reports]
    if reports:
        raise RecordingError(f"the viewer cannot show all of {recording.path}: " + "; ".join(reports))
    try:
        with whole_file(out_png) as part:
            part.write_bytes(_marked(png))
    except OSError as error:
        raise RecordingError(f"cannot write {out_png}: {error.strerror}") from error


def is_picture_of_carom(path: Path) -> bool:
    """Return whether a file is a picture that `render` wrote, so that it may be replaced."""
    try:
        with path.open("rb") as file:
            return _MARK in file.read(_HEAD + 2 * len(_MARK))
    except OSError:
        return False


def _marked(png: bytes) -> bytes:
    """Add a chunk of text to a PNG, after its header; `is_picture_of_carom` recognises the PNG by it."""
    data = b"tEXt" + _MARK
    return png[:_HEAD] + struct.pack(">I", len(_MARK)) + data + struct.pack(">I", zlib.crc32(data)) + png[_HEAD:]


def window_of(size: tuple[int, int], whole: bool) -> tuple[int, int]:
    """Return the size (pixels) of the window in which the picture has this size: the whole window, or its only view."""
    return size if whole else (size[0] + _BORDER[0], size[1] + _BORDER[1])


@contextmanager
def headless(recording: Recording, size: tuple[int, int], theme: str) -> Iterator[Viewer]:
    """Start a viewer of this size (pixels) for a recording, without a screen; end it when the context is left.

    Rerun 0.41 reads its theme only from its settings file, which its headless mode ignores. The headless mode also
    ignores the system's fonts, and the viewer ends at a character that Rerun's own font lacks. A viewer with a window
    on a virtual screen supports themes and pictures. Raises RecordingError if there is no Vulkan driver, or no Xvfb
    where one is needed.
    """
    window = ("--window-size", f"{size[0]}x{size[1]}")
    if theme == "dark" and has_all_glyphs(recording):
        with Viewer("--headless", *window) as viewer:
            yield viewer
        return
    if shutil.which("Xvfb") is None:
        what, other = "with these names", "write names of bodies and files in Latin, Greek or Cyrillic letters"
        if theme == "light":
            what, other = "in the light theme", "use the dark theme"
        raise RecordingError(f"a picture {what} needs Xvfb, a virtual screen: {virtual_screen()}; or {other}")
    folder = Path(tempfile.mkdtemp(dir=private_folder()))
    settings = folder / "rerun" / "app.ron"
    settings.parent.mkdir()
    settings.write_text(_SETTINGS.format(theme=theme.capitalize(), version=rr.__version__))
    kept = {key: value for key, value in os.environ.items() if not key.startswith("WAYLAND_")}
    # RUST_LOG: a viewer with a window shows its log in boxes over the picture
    environment = {**kept, "XDG_DATA_HOME": str(folder), "RUST_LOG": "off"}
    # the pointer starts in the middle of the screen; on a screen twice as large, this is outside the window
    screen = f"{2 * (size[0] + 1)}x{2 * (size[1] + 1)}"
    with Viewer("--persist-state", *window, screen=screen, folder=folder, environment=environment) as viewer:
        viewer.note_ends = time.monotonic() + _NOTE
        yield viewer


def stable_picture(viewer: Viewer, view: str | None) -> bytes:
    """Take pictures until `_ALIKE` in a row are equal, since the viewer loads in parts; return the last picture."""
    alike, last = 0, b""
    end = time.monotonic() + _LIMIT
    while alike < _ALIKE:
        if time.monotonic() > end:
            raise RecordingError(f"the viewer's picture did not settle within {_LIMIT:.0f} s")
        time.sleep(_PAUSE)
        png = viewer.screenshot(view)
        alike = alike + 1 if png == last else 1
        last = png
    return last
