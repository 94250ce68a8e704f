"""Checks and claims output paths before anything is computed for them."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path

from carom.errors import ExistsError, RecordingError
from carom.recording.write.whole_file import Claim

RECORDINGS = Path("recordings")


def default_output(name: str) -> Path:
    """Return the path of the recording of a scene, and make its folder.

    Raises
    ------
    RecordingError
        If it cannot be made.
    """
    output_folder(RECORDINGS)
    return RECORDINGS / f"{name}.rrd"


def refuse_name(path: Path) -> None:
    """Refuse a name that the viewer would not recognise as a recording.

    Raises
    ------
    RecordingError
        With the path and a valid one.
    """
    if path.suffix == ".rrd":
        return
    with contextlib.suppress(OSError):  # folders and devices are refused where they are opened
        if path.exists() and not path.is_file():
            return
    raise RecordingError(f"cannot write {_short(path)}: a recording is an .rrd file")


def refuse_itself(path: Path, source: Path, what: str = "recording") -> None:
    """Refuse to replace the source of an output, even where files may be replaced.

    Parameters
    ----------
    path, source
        The output and its source.
    what
        The kind of source, in a word.

    Raises
    ------
    RecordingError
        If both are the same file.
    """
    if path.exists() and source.exists() and path.samefile(source):
        raise RecordingError(f"{path} is the {what} itself; choose another file with -o")


def refuse_scene_output(path: Path, source: str, force: bool) -> None:
    """Refuse an unsuitable path for a scene that is made from another.

    Raises
    ------
    RecordingError
        With the path and a valid one.
    """
    if path.suffix != ".toml" and not path.is_dir():
        raise RecordingError(f"cannot write {_short(path)}: a scene is a .toml file")
    refuse_itself(path, Path(source), "scene or recording")
    refuse_output(path, force)


def refuse_output(path: Path, force: bool) -> None:
    """Refuse an unsuitable path before anything is computed for it.

    Raises
    ------
    RecordingError
        With the path and a valid one.
    """
    try:
        if is_link_of_another(path):
            raise RecordingError(f"{path}: a link of another user; name another file")
        if path.is_dir():
            raise RecordingError(f"{path}: a folder; name a file to write, such as {path / 'run.rrd'}")
        if path.exists() and not path.is_file():
            raise RecordingError(f"{path}: a device or a pipe; name a file, since a recording is read back")
        if path.exists() and not force:
            raise ExistsError(path)
        if not path.parent.is_dir():
            raise RecordingError(f"{path}: there is no folder {path.parent}; create it first")
    except OSError as error:
        raise RecordingError(f"cannot write {_short(path)}: {error.strerror}") from None


def is_link_of_another(path: Path) -> bool:
    """Return whether a path is a link made by another user."""
    return path.is_symlink() and path.lstat().st_uid not in (0, os.getuid())


@contextlib.contextmanager
def claimed_output(path: Path, force: bool) -> Iterator[Claim]:
    """Check a path with `refuse_output`, and claim it for this process while the context lasts.

    Raises
    ------
    RecordingError
        With the path and a valid one; also if another process writes it.
    """
    refuse_output(path, force)
    with Claim(path) as claim:
        refuse_output(path, force)  # another process may have written it meanwhile
        yield claim


def output_folder(path: Path) -> None:
    """Make a folder for recordings if it does not exist.

    Raises
    ------
    RecordingError
        If it cannot be made.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
    except FileExistsError:
        raise RecordingError(f"{path}: is not a folder, but carom needs a folder of that name; move it") from None
    except OSError as error:
        raise RecordingError(f"{path}: the folder cannot be created: {error.strerror}") from None


def _short(path: Path) -> str:
    """Shorten a path to its beginning if that suffices."""
    text = str(path)
    return text if len(text) <= 200 else f"{text[:200]}…"
