"""Starts Rerun's viewer as a process and drives it: with a window, or headless for pictures."""

from __future__ import annotations

import contextlib
import importlib.util
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Self, TypeVar

import numpy as np

from carom.display import keeper
from carom.display.keeper import HOST, has_screen, screen_is_remote
from carom.display.presentation import Presentation, asked
from carom.display.request import Request
from carom.display.supplement import Supplement
from carom.errors import RecordingError, install_packages
from carom.private_folder import private_folder
from carom.recording.read.recording import Recording
from carom.recording.schema.header import TimeScale
from carom.recording.timelines import SIM_TIME
from carom.recording.write.rerun_compat import connect_viewer

_T = TypeVar("_T")

_LOAD = 120.0  # s, time limit for loading a recording
_POLL = 0.1  # s, interval of checks
_DYING = 2.0  # s in which a viewer that stopped answering may still end
_GRACE = 15.0  # s between requesting the end and killing the process; the process gives its own children 5 s each
_TOO_LATE = "Deadline expired"  # error of Rerun's client at its time limit, which cannot be set
_NO_SCREEN = "there is no screen to open a window on; `carom picture` renders without one"
_DRIVER_WORDS = ("wgpu", "vulkan", "graphics", "adapter", "render context", "xkbcommon", "librar", "egl")
_DREW = "wgpu adapter backend"  # text in the log of a viewer that has a graphics driver
_GLYPH = re.compile(r'No glyph for "(.+?)" \(')
_PANIC = re.compile(r"panicked at '([^\n]+?)'?$", re.MULTILINE)


class Viewer:
    """A viewer process. Leaving the context ends the viewer; the end of this process ends it, too.

    Parameters
    ----------
    options
        Options of Rerun's viewer.
    screen
        WIDTHxHEIGHT of a virtual screen to show it on; by default the user's screen.
    folder
        Folder for temporary files, which the process deletes; by default a new folder.
    keep
        Options of `keeper`.
    """

    def __init__(
        self,
        *options: str,
        screen: str = "",
        folder: Path | None = None,
        keep: tuple[str, ...] = (),
        environment: dict[str, str] | None = None,
    ) -> None:
        self.note_ends = 0.0  # s, monotonic time until which the viewer shows a note
        private = private_folder()
        self._log = tempfile.TemporaryFile(mode="w+", dir=private)  # noqa: SIM115  it lives as long as the process
        beside = private.parent if keeper.LIVE in keep else private  # this process deletes its own folder at its end
        self._folder = folder or Path(tempfile.mkdtemp(prefix="carom-viewer-", dir=beside))
        if not screen and "--headless" not in options and screen_is_remote():
            keep = (*keep, keeper.SHARED)
        reads, writes = os.pipe()
        with os.fdopen(reads) as report:
            self._process = subprocess.Popen(
                [
                    *(sys.executable, "-I", "-S", keeper.__file__),
                    *(str(os.getpid()), str(writes), str(self._folder), ",".join(keep), screen),
                    *(binary(), "--hide-welcome-screen", *options),
                ],
                stdout=self._log,
                stderr=self._log,
                stdin=subprocess.DEVNULL,
                env=environment,
                pass_fds=(writes,),
                start_new_session=True,  # the interrupt key must end the run, not the window
            )
            os.close(writes)
            try:
                port = report.readline().strip()  # empty if the process has ended
                if not port:
                    self._process.wait()
                    self._fail_if_ended()
                self.address = f"{HOST}:{port}"  # address to which a live recording can be sent
                self.client = self._ask(lambda: connect_viewer(f"rerun+http://{self.address}/proxy"))
            except BaseException:
                self._end()
                raise

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        """End the process."""
        self._end()

    def open(self, address: str) -> None:
        """Open a file or an address of a server."""
        self._ask(lambda: self.client.open(address), again=False)

    def show(self, recording: Recording) -> None:
        """Load a recording; wait until it is loaded."""
        self.open(str(recording.path.resolve()))
        self.until("load the recording", _LOAD, lambda: not self._ask(self.client.get_state).loading)

    def add(self, supplement: Supplement) -> None:
        """Add rows and a layout to the recording that is shown; the file does not change."""
        shown = self._ask(self.client.get_state).active_recording
        if shown is None:
            raise RecordingError("the viewer shows no recording")
        _, application, recording_id = shown.split(":")  # the viewer gives each file its own application id
        address = f"rerun+http://{self.address}/proxy"
        self._ask(lambda: supplement.send(address, application, recording_id), again=False)

    def go_to(self, recording: Recording, at: float) -> None:
        """Pause at a simulated time (s)."""
        nanoseconds = TimeScale(float(recording.info["time_scale"])).nanoseconds([at])[0]
        shown = np.timedelta64(int(nanoseconds), "ns")
        self._ask(lambda: self.client.set_time(SIM_TIME, duration=shown, play_state="paused"))

    def screenshot(self, view: str | None = None) -> bytes:
        """Return a PNG of a view, or of the whole window."""
        return self._ask(lambda: self.client.take_screenshot(view))

    def only_view(self, before: str = "") -> str:
        """Wait for a layout with a single view other than ``before``; return the view's id."""
        shown: list[str] = []

        def is_laid_out() -> bool:
            shown[:] = [str(view.view_id) for view in self._ask(self.client.get_state).views]
            return len(shown) == 1 and shown[0] != before

        self.until("lay out the view", _LOAD, is_laid_out)
        return shown[0]

    def wait(self) -> None:
        """Wait until the window is closed."""
        self._process.wait()

    def outlast_note(self) -> None:
        """Wait until a note that the viewer shows after its start is gone."""
        time.sleep(max(0.0, self.note_ends - time.monotonic()))

    def outlast(self, seconds: float) -> None:
        """Wait for some seconds; raise RecordingError if the viewer ends, since it listens before it has a window."""
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(seconds)
        self._fail_if_ended()

    def _ask(self, question: Callable[[], _T], *, again: bool = True) -> _T:
        """Ask the viewer; on failure raise a RecordingError, which gives the reason if the process has ended.

        A busy machine can take longer than Rerun waits for an answer. With ``again``, the question is repeated in this
        case.
        """
        end = time.monotonic() + _LOAD
        while True:
            try:
                return question()
            except RecordingError:
                raise
            except Exception as error:
                with contextlib.suppress(subprocess.TimeoutExpired):
                    self._process.wait(_DYING)
                self._fail_if_ended()
                if again and _TOO_LATE in str(error) and time.monotonic() < end:
                    continue
                raise RecordingError(f"the viewer does not answer: {error}") from error

    def until(self, what: str, limit: float, done: Callable[[], bool]) -> None:
        """Poll until ``done``; raise RecordingError if the process ends or the time runs out first."""
        end = time.monotonic() + limit
        while not done():
            self._fail_if_ended()
            if time.monotonic() > end:
                raise RecordingError(f"the viewer did not {what} within {limit:.0f} s")
            time.sleep(_POLL)

    def _fail_if_ended(self) -> None:
        if self._process.poll() is None:
            return
        self._log.seek(0)
        raise RecordingError(reason_of(self._log.read()))

    def _end(self) -> None:
        self._process.terminate()
        try:
            self._process.wait(_GRACE)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        shutil.rmtree(self._folder, ignore_errors=True)
        self._log.close()


def start_live_viewer() -> str:
    """Open a window that waits for a run and stays open after it; return the address to record to.

    Raises RecordingError if there is no screen, or the viewer cannot use it.
    """
    if not has_screen():
        raise RecordingError(_NO_SCREEN)
    viewer = Viewer("--expect-data-soon", keep=(keeper.LIVE,))
    viewer.outlast(_DYING)
    return viewer.address


def broken_off(said: str) -> str | None:
    """Return the last message of a viewer that crashed; None if it did not crash."""
    if glyph := _GLYPH.search(said):
        return (
            f"the viewer that renders without a screen cannot draw {glyph[1]}, which its font lacks: rename the "
            "bodies whose names contain it, or open the recording with `carom view`"
        )
    found = _PANIC.search(said)
    if found is None or _lacks_driver(found[1]):
        return None
    remedy = "" if _DREW in said else f"; {drawing()}"
    return f"the viewer broke off: {found[1]}{remedy}"


def drawing() -> str:
    """Describe what a viewer needs to draw without a screen, and how to install it."""
    debian = "mesa-vulkan-drivers libvulkan1 libxkbcommon0 libxkbcommon-x11-0"
    fedora = "mesa-vulkan-drivers vulkan-loader libxkbcommon libxkbcommon-x11"
    return f"it needs a Vulkan driver; without a graphics card: {install_packages(debian, fedora)}"


def virtual_screen() -> str:
    """Return the command that installs Xvfb."""
    return install_packages("xvfb", "xorg-x11-server-Xvfb")


def _lacks_driver(said: str) -> bool:
    """Return whether a text says that a graphics card, its driver, or a library for these is missing."""
    return any(word in said.lower() for word in _DRIVER_WORDS)


def reason_of(said: str) -> str:
    """Return the reason why a viewer ended, according to its log, and a remedy."""
    last = said.strip().splitlines()[-1] if said.strip() else "it ended without a word"
    lowered = said.lower()
    if broken := broken_off(said):
        return broken
    if "xvfb" in lowered:
        reason = f"{last}: {virtual_screen()}; {drawing()}"
    elif _lacks_driver(said):
        reason = drawing()
    elif "display" in lowered or "winit" in lowered or "wayland" in lowered:
        reason = _NO_SCREEN
    else:
        reason = f"{last}; {drawing()}"
    return f"the viewer could not start: {reason}"


def binary() -> str:
    """Find the viewer of the installed rerun-sdk; a viewer on the PATH may have another version."""
    spec = importlib.util.find_spec("rerun_cli")
    for folder in (spec.submodule_search_locations or []) if spec else []:
        for name in ("rerun", "rerun.exe"):
            if (Path(folder) / name).is_file():
                return str(Path(folder) / name)
    raise RecordingError("rerun-sdk is installed without its viewer (the package rerun_cli)")


def view(
    recording: Recording | str | Path, at: float | None = None, *, event: str | None = None, bodies: str | None = None
) -> None:
    """Open Rerun's viewer in a window, paused at a moment; return when the window is closed.

    Raises RecordingError if there is no such moment, event or body, or no screen.

    Parameters
    ----------
    recording
        The recording, or its file.
    at
        Time in s; by default the event or, without an event, the most interesting moment.
    event
        The name of an event, whose bodies the close-up view shows.
    bodies
        The bodies of the close-up view, by numbers or names separated by a comma.
    """
    open_window(recording.path if isinstance(recording, Recording) else recording, Request(at, event, bodies))


def open_window(path: str | Path, request: Request, *, say: Callable[[str], None] = lambda _: None) -> None:
    """Open a recording, paused at a moment; return when the window is closed.

    ``say`` is called with the reason if the step of the moment cannot be shown. Raises RecordingError if the recording
    cannot be read, there is no such moment, event, body or quantity, or no screen.
    """
    recording = Recording.open(path)
    shown: Presentation | None = None
    moment = request.at
    if not recording.is_overlay:
        shown = asked(recording, request, dense=True)
        moment = shown.time
    with Viewer() as viewer:
        viewer.show(recording)
        if shown is not None:
            viewer.add(shown.supplement)
            say(shown.missing)
        if moment is not None:
            viewer.go_to(recording, moment)
        viewer.wait()
