"""The one temporary folder of a process: it is closed to other users, and removed when the process ends.

If several users share a machine, each can make a folder of any name in the system's temporary folder. This folder
therefore has a random name and mode 0700, and a location where no other user can replace it. It contains every
temporary file of carom. A process that is killed leaves its folder behind; the next process of the same user removes
it.
"""

from __future__ import annotations

import atexit
import contextlib
import fcntl
import grp
import os
import pwd
import shutil
import stat
import tempfile
import threading
from collections.abc import Iterator
from functools import cache
from pathlib import Path

PREFIX = "carom-"
MARK = "made-by-carom"  # name of a file in each locked folder; a folder without this file is never removed
_above: list[Path] = []  # the folder of the parent process
_guard = threading.Lock()
_made: dict[int, tuple[Path, int]] = {}  # by process: its folder, and the descriptor that locks the folder


def private_folder() -> Path:
    """Return the temporary folder of this process; make it at the first call.

    Child processes get the folder as ``TMPDIR`` for their own temporary files. Raises OSError if no temporary folder is
    writable, or others can replace its content.
    """
    with _guard:
        known = _made.get(os.getpid())
        if known is None or not known[0].is_dir():  # a forked process has no folder, or another program removed it
            known = _made[os.getpid()] = _make()
            atexit.register(remove_private_folder)
        return known[0]


def move_into(folder: Path) -> None:
    """Make this process's folder inside a folder of its parent process; the parent removes both."""
    _above.append(folder)


@contextlib.contextmanager
def temporary_folder() -> Iterator[Path]:
    """Yield an empty folder within the private folder; it is removed at the end of the context."""
    folder = Path(tempfile.mkdtemp(dir=private_folder()))
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def remove_private_folder() -> None:
    """Remove the folder of this process, if it has made one."""
    made = _made.pop(os.getpid(), None)
    if made is not None:
        shutil.rmtree(made[0], ignore_errors=True)
        os.close(made[1])


def is_own(folder: Path) -> bool:
    """Return whether a folder, not a link, belongs to this user and nobody else can write to or replace it."""
    try:
        status = folder.lstat()
    except OSError:
        return False
    own = stat.S_ISDIR(status.st_mode) and status.st_uid == os.getuid()
    return own and not _others_write(status) and is_fixed(folder)


def is_fixed(path: Path) -> bool:
    """Return whether the permissions of the parents of a path let only this user and the system replace it."""
    try:
        # the owner of the root folder can do anything; in a container, that may be "nobody"
        trusted = (0, os.getuid(), Path("/").stat().st_uid)
        above = [parent.stat() for parent in (path.parent, *path.parent.resolve().parents)]
    except OSError:
        return False
    return all(
        parent.st_uid in trusted and (parent.st_mode & stat.S_ISVTX or not _others_write(parent)) for parent in above
    )


def _others_write(status: os.stat_result) -> bool:
    by_group = status.st_mode & stat.S_IWGRP and status.st_gid != _private_group()
    return bool(by_group or status.st_mode & stat.S_IWOTH)


@cache
def _private_group() -> int:
    """Return the group of this user alone, which many systems make for each user; -1 if there is none."""
    try:
        user = pwd.getpwuid(os.getuid())
        group = grp.getgrgid(user.pw_gid)
    except KeyError:
        return -1
    return group.gr_gid if group.gr_name == user.pw_name and set(group.gr_mem) <= {user.pw_name} else -1


def _make() -> tuple[Path, int]:
    names = (*_above, tempfile.gettempdir(), os.environ.get("XDG_RUNTIME_DIR"), "/tmp")
    places = [Path(name).resolve() for name in names if name]
    fit = [place for place in places if os.access(place, os.W_OK | os.X_OK) and is_fixed(place / PREFIX)]
    if not fit:
        raise PermissionError(
            f"other users can replace files in {places[0]}; set TMPDIR to a folder that only you can write to"
        )
    _remove_left(fit[0])
    folder = Path(tempfile.mkdtemp(prefix=PREFIX, dir=fit[0]))
    lock = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    # raised on a file system without locks; systemd-tmpfiles leaves a locked folder alone
    with contextlib.suppress(OSError):
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        (folder / MARK).touch()
    return folder, lock


def _remove_left(place: Path) -> None:
    """Remove the folders of this user's processes that were killed: folders that are marked, and no longer locked."""
    for folder in place.glob(f"{PREFIX}*"):
        if not is_own(folder) or not (folder / MARK).is_file():
            continue
        with contextlib.suppress(OSError):
            lock = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                shutil.rmtree(folder, ignore_errors=True)
            finally:
                os.close(lock)
