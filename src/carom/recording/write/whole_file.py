"""Output files: checked and claimed before a computation, locked, and complete when they appear.

A full disk or an interrupt leaves the previous file unchanged.
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import os
import secrets
import shutil
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Self

from carom.errors import DroppedRunWarning, ExistsError, RecordingError
from carom.private_folder import is_fixed, temporary_folder

RECORDINGS = Path("recordings")


def default_output(name: str) -> Path:
    """Return the path of the recording of a scene, and make its folder. Raises RecordingError if it cannot be made."""
    output_folder(RECORDINGS)
    return RECORDINGS / f"{name}.rrd"


def refuse_name(path: Path) -> None:
    """Raise RecordingError for a name that the viewer would not recognise as a recording."""
    if path.suffix == ".rrd":
        return
    with contextlib.suppress(OSError):  # folders and devices are refused when they are opened
        if path.exists() and not path.is_file():
            return
    raise RecordingError(f"cannot write {_short(path)}: a recording is an .rrd file")


def refuse_itself(path: Path, source: Path, what: str = "recording") -> None:
    """Raise RecordingError if an output is its own source, of the kind ``what``, even if files may be replaced."""
    if path.exists() and source.exists() and path.samefile(source):
        raise RecordingError(f"{path} is the {what} itself; choose another file with -o")


def refuse_scene_output(path: Path, source: str, force: bool) -> None:
    """Raise RecordingError, with the remedy, for an unsuitable path of a scene that is made from another scene."""
    if path.suffix != ".toml" and not path.is_dir():
        raise RecordingError(f"cannot write {_short(path)}: a scene is a .toml file")
    refuse_itself(path, Path(source), "scene or recording")
    refuse_output(path, force)


def refuse_output(path: Path, force: bool) -> None:
    """Raise RecordingError, with the remedy, for an unsuitable path, before anything is computed for it."""
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
    """Check a path with `refuse_output`, and claim it. Raises RecordingError also if another process writes there."""
    refuse_output(path, force)
    with Claim(path) as claim:
        refuse_output(path, force)  # another process may have written the file meanwhile
        yield claim


def output_folder(path: Path) -> None:
    """Make a folder for recordings if it does not exist. Raises RecordingError if it cannot be made."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except FileExistsError:
        raise RecordingError(f"{path}: is not a folder, but carom needs a folder of that name; move it") from None
    except OSError as error:
        raise RecordingError(f"{path}: the folder cannot be created: {error.strerror}") from None


_LONGEST = 200  # characters of a path in a message


def _short(path: Path) -> str:
    """Return the text of a path, cut after `_LONGEST` characters."""
    text = str(path)
    return text if len(text) <= _LONGEST else f"{text[:_LONGEST]}…"


# An exclusive lock on an output file, since two processes that write one file would destroy both recordings.

_NO_LOCKS = (errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP)


class Claim:
    """Keeps other carom processes from writing a path, until it is released or the process ends.

    The lock is on a file beside the output, ``.NAME.lock``, because the output itself may be replaced while it is
    claimed. A killed process leaves that file, without its lock. File systems without locks, such as some network file
    systems, do not refuse the second writer. Raises RecordingError if another process writes the path, or if the path
    cannot be written.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            real = path.resolve()
            self._lock = real.with_name(f".{real.name}.lock")
            self._descriptor = _locked(self._lock)
        except BlockingIOError:
            raise RecordingError(
                f"{path}: another carom process is writing it; wait for its end, or name another file"
            ) from None
        except (OSError, RuntimeError) as error:  # RuntimeError: links in a circle
            reason = error.strerror if isinstance(error, OSError) else error
            raise RecordingError(f"cannot write {path}: {reason}") from error

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.release()

    def release(self) -> None:
        """Release the path."""
        with contextlib.suppress(OSError):
            self._lock.unlink()  # while still locked, so that a process that opened it meanwhile finds it deleted
        os.close(self._descriptor)


def lock(descriptor: int) -> None:
    """Lock a file, if its file system has locks. Raises BlockingIOError if another process has the lock."""
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        if error.errno not in _NO_LOCKS:
            raise


def _locked(path: Path) -> int:
    """Open and lock a file, and check that it still exists. Raises BlockingIOError if another process has the lock."""
    while True:
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o666)
        try:
            lock(descriptor)
        except OSError:
            os.close(descriptor)
            raise
        with contextlib.suppress(FileNotFoundError):
            if os.path.samestat(os.fstat(descriptor), path.stat()):
                return descriptor
        os.close(descriptor)


def name_until_whole(path: Path) -> Path:
    """Return the path to which a run is recorded until it replaces an earlier recording."""
    return path.with_name(f".{path.stem}.new.rrd")


def killed_run_of(path: Path) -> Path | None:
    """Return the file of a run that was killed before it replaced a recording; None without a file or while it runs."""
    with contextlib.suppress(OSError, RuntimeError):  # RuntimeError: links in a circle
        real = path.resolve()
        lock, left = real.with_name(f".{real.name}.lock"), name_until_whole(real)
        if not left.is_file():
            return None
        with contextlib.suppress(FileNotFoundError), lock.open("rb") as file:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)  # OSError while another process writes the recording
        return path.with_name(left.name)
    return None


@contextlib.contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """Yield a new path with the same suffix; on success its file gets the name ``path``, on failure it is removed.

    In a folder that other users can write to, their links are not followed. Nobody can predict the new name. If others
    could replace the file, it is written in the private folder instead.
    """
    with new_name(path, path.suffix) as part, contextlib.ExitStack() as stack:
        if is_fixed(path):
            part.open("xb").close()
            yield part
        else:
            filled = stack.enter_context(temporary_folder()) / path.name
            yield filled
            with filled.open("rb") as source, part.open("xb") as target:
                shutil.copyfileobj(source, target)
        part.replace(path)


@contextlib.contextmanager
def new_name(path: Path, ending: str) -> Iterator[Path]:
    """Yield an unused path beside another, and remove its file at the end. Open it with mode ``x``."""
    part = path.with_name(f".{path.stem}.{secrets.token_hex(4)}{ending}")
    try:
        yield part
    finally:
        with contextlib.suppress(OSError):
            part.unlink(missing_ok=True)


def write_whole(path: Path, text: str) -> None:
    """Write a text; OSError if it cannot be written."""
    with whole_file(path) as part:
        part.write_text(text, encoding="utf-8")


def new_file(path: Path) -> Path:
    """Return the file to write for a path: a new file beside an existing recording; a killed run's file is replaced."""
    try:
        path = path.resolve()
        if not path.exists():
            return path
        beside = name_until_whole(path)
        if beside.exists():
            said = f"{beside.name}, the file of a run that was killed, is replaced by the file of the new run"
            warnings.warn(said, DroppedRunWarning, stacklevel=3)
        beside.unlink(missing_ok=True)
    except (OSError, RuntimeError) as error:  # RuntimeError: links in a circle
        raise RecordingError(f"cannot write {path}: {getattr(error, 'strerror', None) or error}") from error
    return beside
