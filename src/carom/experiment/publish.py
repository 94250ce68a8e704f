"""Publishes a recording as a folder for any static host: a page with its moments, the viewer and the recording."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path

from carom.experiment.overview import Moment, moments, overview
from carom.recording.errors import RecordingError
from carom.recording.read.recording import Recording
from carom.recording.view.picture import try_to_render
from carom.recording.view.presentation import presentation
from carom.recording.view.web import index_page, site
from carom.recording.view.web.index_page import Figure
from carom.recording.write.claim import Claim
from carom.scene.units.dimension import TIME

_OURS = re.compile(r"moment-\d+\.(png|rbl|rrd)")
_SIZE = (1600, 1000)  # pixels of a picture


@dataclass(frozen=True, slots=True)
class Published:
    """Result of publishing."""

    path: Path
    size: int  # bytes
    moments: int
    picture: str  # empty, or why there are no pictures


def publish(recording: Recording, folder: Path, watch: Callable[[str], None] = lambda _: None) -> Published:
    """Write the folder; an earlier one by carom is replaced once the new one is complete.

    Parameters
    ----------
    recording
        A whole run, or a clip.
    folder
        The folder to write.
    watch
        Called with a description of each stage.

    Raises
    ------
    RecordingError
        If the recording has no frame, or the folder cannot be written.
    """
    summary = recording.summary()
    units = recording.units
    found = moments(summary, units) or [_fullest(recording)]
    missing = ""
    with Claim(folder), _replacing(folder) as part:
        watch("the recording")
        shutil.copyfile(recording.path, part / site.RECORDING)
        watch("the viewer")
        site.write_viewer(recording, part)
        figures = []
        for number, together in enumerate(_together(found), 1):
            name, time = f"moment-{number}", together[0].time
            watch(f"the moment at {units.text(time, TIME)}")
            shown = presentation(recording, time)
            link = site.write_moment(recording, shown.time, shown.supplement, part, name)
            if not missing:
                missing = try_to_render(recording.path, time, part / f"{name}.png", _SIZE)
            lines = [f"{moment.text[0].upper()}{moment.text[1:]}" for moment in together]
            lines.append(f"t = {units.text(time, TIME, '.9g')}")
            figures.append(Figure(lines, link, "" if missing else f"{name}.png"))
        index_page.write_index(part, recording.title, recording.path.name, overview(recording), figures)
        size = sum(file.stat().st_size for file in part.iterdir())
    return Published(folder, size, len(figures), missing)


def refuse_folder(folder: Path, force: bool) -> None:
    """Refuse an unsuitable folder before anything is made for it.

    Raises
    ------
    RecordingError
        Naming the folder and what would be right.
    """
    if folder.is_file():
        raise RecordingError(f"{folder}: a file; name a folder to write")
    if not folder.parent.is_dir():
        raise RecordingError(f"{folder}: there is no folder {folder.parent}; make it first")
    if not folder.exists():
        return
    foreign = sorted(name for name in (file.name for file in folder.iterdir()) if not _is_ours(name))
    page = folder / index_page.INDEX
    if page.is_file() and index_page.MARK not in page.read_text(encoding="utf-8", errors="replace"):
        foreign = [index_page.INDEX, *foreign]
    if foreign:
        raise RecordingError(f"{folder}: holds {foreign[0]}, which carom did not write; name another folder")
    if not force:
        raise RecordingError(f"{folder}: exists; give --force to replace it, or name another with -o")


def _is_ours(name: str) -> bool:
    known = (*site.FILES, site.RECORDING, index_page.INDEX, index_page.STYLE)
    return name in known or _OURS.fullmatch(name) is not None


def _fullest(recording: Recording) -> Moment:
    """Return the moments of a run without contacts, or of one that was killed."""
    time = recording.moment()
    table = recording.fingerprints()
    row = int(abs(table["time"].to_numpy() - time).argmin())
    return Moment("the moment to look at", int(table["step"][row].as_py()), time)


def _together(found: Sequence[Moment]) -> Iterator[list[Moment]]:
    """Group the moments of one step, in order of time."""
    return (list(group) for _, group in groupby(sorted(found, key=lambda moment: moment.step), lambda one: one.step))


@contextmanager
def _replacing(folder: Path) -> Iterator[Path]:
    """Yield an empty folder that replaces this one on success and is removed on failure."""
    part, old = (folder.with_name(f".{folder.name}.{state}") for state in ("part", "old"))
    shutil.rmtree(part, ignore_errors=True)  # of a process that was killed
    try:
        part.mkdir()
        yield part
        if folder.exists():
            folder.rename(old)
        try:
            part.rename(folder)
        except BaseException:
            if old.exists():
                old.rename(folder)
            raise
        shutil.rmtree(old, ignore_errors=True)
    except OSError as error:
        raise RecordingError(f"cannot write {folder}: {error.strerror}") from None
    finally:
        shutil.rmtree(part, ignore_errors=True)
