"""A virtual screen (Xvfb) for pictures that Rerun's headless mode cannot render.

Rerun 0.41 reads its theme only from its settings file, and its headless mode reads no settings. Nor does that mode use
the fonts of the system, and it ends at a character that Rerun's own font lacks. A viewer with a window does both.
"""

from __future__ import annotations

import contextlib
import os
import shutil
import subprocess
import tempfile
from collections.abc import Iterator
from pathlib import Path

import rerun as rr

from carom.recording.errors import RecordingError

_SETTINGS = '{{"egui": "(options:(theme_preference:{theme}))", "rerun.version": "{version}"}}'
_GRACE = 5.0  # s between asking the screen to end and ending it


@contextlib.contextmanager
def virtual_screen(size: tuple[int, int], theme: str) -> Iterator[dict[str, str]]:
    """Yield the environment of a viewer with a theme, "dark" or "light", on a virtual screen of this size (pixels).

    Raises
    ------
    RecordingError
        If there is no Xvfb.
    """
    program = shutil.which("Xvfb")
    if program is None:
        what, other = "with these names", "write names of bodies and files in Latin, Greek or Cyrillic letters"
        if theme == "light":
            what, other = "in the light theme", "take the dark theme"
        raise RecordingError(f"a picture {what} needs Xvfb, a virtual screen: apt-get install xvfb; or {other}")
    with tempfile.TemporaryDirectory(prefix="carom-") as folder:
        settings = Path(folder) / "rerun" / "app.ron"
        settings.parent.mkdir()
        settings.write_text(_SETTINGS.format(theme=theme.capitalize(), version=rr.__version__))
        with _screen(program, size) as display:
            kept = {key: value for key, value in os.environ.items() if not key.startswith("WAYLAND_")}
            # RUST_LOG: a viewer with a window shows its log in boxes over the picture
            yield {**kept, "DISPLAY": display, "XDG_DATA_HOME": folder, "RUST_LOG": "off"}


@contextlib.contextmanager
def _screen(program: str, size: tuple[int, int]) -> Iterator[str]:
    """Start a virtual screen around a window of this size; yield its name once it is there."""
    reads, writes = os.pipe()
    # The pointer starts in the middle of the screen: beyond the window, where it hovers over nothing.
    width, height = 2 * (size[0] + 1), 2 * (size[1] + 1)
    geometry = f"{width}x{height}x24"
    process = subprocess.Popen(
        [program, "-displayfd", str(writes), "-screen", "0", geometry, "-nolisten", "tcp"],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        stdin=subprocess.DEVNULL,
        pass_fds=(writes,),
    )
    os.close(writes)
    try:
        with os.fdopen(reads) as told:
            number = told.readline().strip()  # empty if Xvfb has ended
        if not number:
            raise RecordingError("Xvfb, the virtual screen, did not start")
        yield f":{number}"
    finally:
        process.terminate()
        try:
            process.wait(_GRACE)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
