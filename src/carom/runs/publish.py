"""Publishes a recording as a folder for any static host: a page with its moments, the viewer and the recording."""

from __future__ import annotations

import json
import re
import secrets
import shutil
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path

import xxhash

from carom.errors import RecordingError
from carom.recording.read.recording import Recording
from carom.recording.write.whole_file import Claim, write_whole
from carom.runs.output import is_link_of_another
from carom.runs.overview import Moment, moments, overview
from carom.scene.units.dimension import TIME
from carom.show.picture import try_to_render
from carom.show.presentation import asked
from carom.show.request import Request
from carom.show.web import site
from carom.show.web.site import Figure

LIST = "carom-page.json"  # the list of a publication's files, with their digests
WHAT = "files of a page that carom published; `carom publish --force` replaces these and no others"
_PART = re.compile(r"\.[0-9a-f]{8}\.part")
_SIZE = (1600, 1000)  # pixels of a picture


@dataclass(frozen=True, slots=True)
class Published:
    """Result of publishing."""

    path: Path
    size: int  # bytes
    moments: int
    picture: str  # empty, or the reason for missing pictures


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
            impact = any(moment.name == "impact" for moment in together)
            wanted = Request(event="impact") if impact else Request(time)
            shown = asked(recording, wanted)
            link = site.write_moment(recording, shown.time, shown.supplement, part, name)
            if not missing:
                missing = try_to_render(recording.path, wanted, part / f"{name}.png", _SIZE)
            lines = [f"{moment.text[0].upper()}{moment.text[1:]}" for moment in together]
            lines.append(f"t = {units.text(shown.time, TIME, '.9g')}")
            figures.append(Figure(lines, link, "" if missing else f"{name}.png"))
        site.write_index(part, recording.title, recording.path.name, overview(recording), figures)
        size = sum(file.stat().st_size for file in part.iterdir())
    return Published(folder, size, len(figures), missing)


def refuse_folder(folder: Path, force: bool) -> None:
    """Refuse an unsuitable folder before anything is computed.

    Raises
    ------
    RecordingError
        With the folder and a valid one.
    """
    if is_link_of_another(folder):
        raise RecordingError(f"{folder}: a link of another user; name another folder")
    if folder.is_file():
        raise RecordingError(f"{folder}: a file; name a folder to write")
    if not folder.resolve().parent.is_dir():
        raise RecordingError(f"{folder}: there is no folder {folder.parent}; make it first")
    if not folder.exists():
        return
    listed = _listed(folder)
    for path in sorted(folder.iterdir()):
        digest = listed.get(path.name)
        if path.name == LIST or digest == _digest(path) or (digest == "" and not _is_folder(path)):
            continue
        what = "was changed since carom wrote it" if digest is not None else "which carom did not write"
        raise RecordingError(f"{folder}: holds {path.name}, {what}; name another folder")
    if not force and listed:
        raise RecordingError(f"{folder}: exists; give --force to replace it, or name another with -o")


def _listed(folder: Path) -> dict[str, str]:
    """Return the digests of a publication's files by name; none without a list.

    The digest of a possibly incomplete file is empty.
    """
    try:
        stored = json.loads((folder / LIST).read_text(encoding="utf-8"))["files"]
        if any(Path(name).name != name or not isinstance(digest, str) for name, digest in stored.items()):
            raise ValueError("a name that is no file of this folder")
    except FileNotFoundError:
        return {}
    except (OSError, ValueError, TypeError, LookupError, AttributeError, RecursionError):
        raise RecordingError(f"{folder}: holds {LIST}, which carom did not write; name another folder") from None
    return dict(stored)


def _digest(path: Path) -> str:
    """Return the digest of a file; for a link or a folder, a text that no list contains."""
    if path.is_symlink() or not path.is_file():
        return "not a file"
    whole = xxhash.xxh3_128()
    with path.open("rb") as file:
        while piece := file.read(1 << 20):
            whole.update(piece)
    return whole.hexdigest()


def _fullest(recording: Recording) -> Moment:
    """Return the moments of a run that has no contacts or was killed."""
    time = recording.moment()
    table = recording.fingerprints()
    row = int(abs(table["time"].to_numpy() - time).argmin())
    return Moment("", "the moment to look at", int(table["step"][row].as_py()), time)


def _together(found: Sequence[Moment]) -> Iterator[list[Moment]]:
    """Group the moments of one step, in order of time."""
    return (list(group) for _, group in groupby(sorted(found, key=lambda moment: moment.step), lambda one: one.step))


@contextmanager
def _replacing(folder: Path) -> Iterator[Path]:
    """Yield an empty folder whose files move into this one on success; on failure nothing changes.

    The files are replaced one by one, since the folder may be a link, the current folder or a mounted disk. The list is
    written first, so that the next publication recognises the files even if this one is killed.
    """
    real, fresh = folder.resolve(), not folder.exists()
    try:
        real.mkdir(exist_ok=True)
        listed = before = _listed(real)
        part = real / f".{secrets.token_hex(4)}.part"
        try:
            _list(real, {**before, part.name: ""})
            part.mkdir(0o700)
            yield part
            made = {path.name: _digest(path) for path in part.iterdir()}
            listed = dict.fromkeys({*before, *made}, "")
            _list(real, {**listed, part.name: ""})
            for name in made:
                (part / name).replace(real / name)
            for name in before.keys() - made.keys():
                _remove(real / name)
            part.rmdir()
            listed = made
        finally:
            _remove(part)
            if listed:
                _list(real, listed)
            else:
                (real / LIST).unlink(missing_ok=True)
                if fresh:
                    real.rmdir()
    except OSError as error:
        raise RecordingError(f"cannot write {folder}: {error.strerror}") from None


def _list(folder: Path, files: dict[str, str]) -> None:
    write_whole(folder / LIST, json.dumps({"what": WHAT, "files": dict(sorted(files.items()))}, indent=1) + "\n")


def _remove(path: Path) -> None:
    """Remove a listed file, or the folder of a killed publication."""
    if _PART.fullmatch(path.name):
        shutil.rmtree(path, ignore_errors=True)
    else:
        path.unlink(missing_ok=True)


def _is_folder(path: Path) -> bool:
    """Return whether a path is a folder, but not one of a killed publication."""
    return path.is_dir() and not path.is_symlink() and not _PART.fullmatch(path.name)
