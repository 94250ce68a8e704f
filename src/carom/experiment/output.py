"""Where runs may write."""

from __future__ import annotations

from pathlib import Path

from carom.recording.errors import RecordingError


def refuse_output(path: Path, force: bool) -> None:
    """Refuse a path before anything is computed for it.

    Raises
    ------
    RecordingError
        Naming the path and what would be right.
    """
    if path.is_dir():
        raise RecordingError(f"{path}: a folder; name a file to write, such as {path / 'run.rrd'}")
    if path.exists() and not force:
        raise RecordingError(f"{path}: exists; give --force to replace it, or another name with -o")
    if not path.parent.is_dir():
        raise RecordingError(f"{path}: there is no folder {path.parent}; make it first")


def output_folder(path: Path) -> None:
    """Make a folder for recordings, where there is none yet.

    Raises
    ------
    RecordingError
        If it cannot be made.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise RecordingError(f"{path}: cannot be made a folder: {error.strerror}") from None
