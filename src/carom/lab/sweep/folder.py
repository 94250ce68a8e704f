"""The folder of a sweep, shared by the command and all workers."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import os
import re
import shutil
import uuid
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

from carom.errors import ExperimentError
from carom.recording.write.whole_file import new_name
from carom.runs.output import is_link_of_another, output_folder

_ATTEMPT = re.compile(r"\.?(.+)\.[0-9a-f]{8}\.rrd(\.\w+)?")  # a recording being written, or its lock
NO_ROOM = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)


@dataclass(frozen=True, slots=True)
class Folder:
    """The paths of a sweep."""

    root: Path

    @property
    def scene(self) -> Path:
        """The scene of all runs, without the varied values."""
        return self.root / "scene.toml"

    @property
    def data(self) -> Path:
        """Copies of the data files that the scene reads."""
        return self.root / "data"

    @property
    def manifest(self) -> Path:
        """The outcomes of all runs."""
        return self.root / "manifest.json"

    @property
    def table(self) -> Path:
        """The summary as Parquet."""
        return self.root / "table.parquet"

    @property
    def partial(self) -> Path:
        """Recordings being written."""
        return self.root / "partial"

    def whole(self, name: str) -> Path:
        """Return the path of the recording of a completed run."""
        return self.recordings[0] / f"{name}.rrd"

    def failed(self, name: str) -> Path:
        """Return the path of the recording of a failed run."""
        return self.recordings[1] / f"{name}.rrd"

    def attempt(self, name: str) -> Path:
        """Return a unique path for writing a recording, different even for attempts at the same run."""
        return self.partial / f"{name}.{uuid.uuid4().hex[:8]}.rrd"

    @property
    def tables(self) -> tuple[Path, Path]:
        """The summary as Parquet and as CSV."""
        return self.table, self.table.with_suffix(".csv")

    def make(self) -> None:
        """Make the folder and its subfolders."""
        for part in (self.root, *self.recordings, self.partial):
            output_folder(part)

    def refuse_links(self) -> None:
        """Refuse a folder in which another user has put a link in the place of a subfolder."""
        for part in (*self.recordings, self.partial, self.data):
            if is_link_of_another(part):
                raise ExperimentError(f"{part}: a link of another user; choose another folder with -o")

    @property
    def recordings(self) -> tuple[Path, Path]:
        """The folders of completed runs and of failed ones."""
        return self.root / "runs", self.root / "failed"

    def path_of(self, name: str) -> Path | None:
        """Return the path of a file that a manifest names; None if that is not in this folder."""
        path = self.root / name
        return path if path.name == name or path.parent.resolve().is_relative_to(self.root.resolve()) else None

    @property
    def is_fresh(self) -> bool:
        """Whether nothing is in the folder besides the lock."""
        return all(path == self._lock for path in self.root.iterdir())

    @property
    def _lock(self) -> Path:
        return self.root / ".claim"

    def leave(self) -> None:
        """Remove what is empty after a sweep that could not begin."""
        for folder in (*self.recordings, self.partial, self.data):
            with contextlib.suppress(OSError):
                folder.rmdir()
        self._lock.unlink(missing_ok=True)
        with contextlib.suppress(OSError):
            self.root.rmdir()

    def clear_partial(self, names: Iterable[str]) -> None:
        """Remove leftovers of earlier attempts at runs of these names."""
        ours = set(names)
        with contextlib.suppress(FileNotFoundError, NotADirectoryError):
            for path in self.partial.iterdir():
                attempt = _ATTEMPT.fullmatch(path.name)
                if attempt and attempt[1] in ours:
                    path.unlink(missing_ok=True)

    def clear(self, names: Iterable[str], files: Iterable[str]) -> None:
        """Remove the runs and files that a manifest lists, the manifest last, and no other."""
        ours = set(names)
        self.clear_partial(ours)
        for folder in self.recordings:
            for path in folder.glob("*.rrd"):
                if path.name.removesuffix(".rrd") in ours and not path.is_dir():
                    path.unlink()
        for path in filter(None, map(self.path_of, files)):
            path.unlink(missing_ok=True)
            for above in path.parents[: len(path.parts) - len(self.root.parts) - 1]:
                with contextlib.suppress(OSError):
                    above.rmdir()
        self.manifest.unlink(missing_ok=True)
        for folder in (*self.recordings, self.partial, self.data):
            with contextlib.suppress(OSError):
                folder.rmdir()

    @contextlib.contextmanager
    def claimed(self) -> Iterator[None]:
        """Lock the folder against other sweeps; the lock ends with the process.

        Raises
        ------
        ExperimentError
            If another sweep runs here.
        """
        try:
            claim = os.open(self._lock, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC, 0o666)
        except OSError as error:
            raise ExperimentError(f"{self._lock}: cannot be opened: {error.strerror}; choose another folder") from None
        try:
            fcntl.flock(claim, fcntl.LOCK_EX | fcntl.LOCK_NB)
            yield
        except BlockingIOError:
            raise ExperimentError(f"{self.root}: another sweep runs here; wait for it, or end it") from None
        finally:
            os.close(claim)


def put(path: Path, content: str | bytes) -> None:
    """Write a file atomically: after a crash it has either its old or its new content."""
    try:
        with new_name(path, ".new") as beside:
            with beside.open("xb") as file:
                file.write(content.encode() if isinstance(content, str) else content)
                file.flush()
                os.fsync(file.fileno())
            move(beside, path)
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(path)) from error  # that of a full disk names no file


def put_copy(path: Path, source: Path) -> None:
    """Copy a file atomically, unless a copy is there."""
    known, found = source.stat(), path.stat() if path.exists() else None
    if found is not None and (found.st_size, found.st_mtime_ns) == (known.st_size, known.st_mtime_ns):
        return
    with new_name(path, ".new") as beside:
        with source.open("rb") as original, beside.open("xb") as copy:
            shutil.copyfileobj(original, copy)
        os.utime(beside, ns=(known.st_atime_ns, known.st_mtime_ns), follow_symlinks=False)
        move(beside, path)


def move(path: Path, to: Path) -> None:
    """Rename a file, replacing an existing one, and make the new name durable."""
    path.replace(to)
    folder = os.open(to.parent, os.O_RDONLY)
    try:
        os.fsync(folder)
    finally:
        os.close(folder)
