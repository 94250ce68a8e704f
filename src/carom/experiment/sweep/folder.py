"""The folder of a sweep, shared by the command and all workers."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import os
import shutil
import uuid
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from carom.experiment.error import ExperimentError
from carom.experiment.output import output_folder

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
        """The summary as Parquet; a CSV copy is beside it."""
        return self.root / "table.parquet"

    @property
    def partial(self) -> Path:
        """Recordings being written."""
        return self.root / "partial"

    def whole(self, name: str) -> Path:
        """Return the path of the recording of a completed run."""
        return self.root / "runs" / f"{name}.rrd"

    def failed(self, name: str) -> Path:
        """Return the path of the recording of a failed run."""
        return self.root / "failed" / f"{name}.rrd"

    def attempt(self, name: str) -> Path:
        """Return a unique path for writing a recording, different even for attempts at the same run."""
        return self.partial / f"{name}.{uuid.uuid4().hex[:8]}.rrd"

    def make(self) -> None:
        """Make the folder and its subfolders."""
        for part in (self.root, self.root / "runs", self.root / "failed", self.partial):
            output_folder(part)

    @property
    def is_fresh(self) -> bool:
        """Whether nothing is in the folder besides the lock."""
        return all(path == self._lock for path in self.root.iterdir())

    @property
    def _lock(self) -> Path:
        return self.root / ".claim"

    def remove(self) -> None:
        """Remove the files of a sweep that could not begin, and the folder if nothing else is in it."""
        self.clear()
        self._lock.unlink(missing_ok=True)
        with contextlib.suppress(OSError):
            self.root.rmdir()

    def clear_partial(self) -> None:
        """Remove leftovers of earlier attempts."""
        for path in self.partial.iterdir():
            path.unlink(missing_ok=True)

    def clear(self) -> None:
        """Remove all files of a sweep, and nothing else."""
        for part in ("runs", "failed", "partial", "data"):
            shutil.rmtree(self.root / part, ignore_errors=True)
        for path in (self.manifest, self.scene, self.table, self.table.with_suffix(".csv")):
            path.unlink(missing_ok=True)

    @contextlib.contextmanager
    def claimed(self) -> Iterator[None]:
        """Lock the folder against other sweeps; the lock ends with the process.

        Raises
        ------
        ExperimentError
            If another sweep runs here.
        """
        with self._lock.open("w") as claim:
            try:
                fcntl.flock(claim, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError:
                raise ExperimentError(f"{self.root}: another sweep runs here; wait for it, or end it") from None
            yield


def put(path: Path, content: str | bytes) -> None:
    """Write a file atomically: after a crash it has either its old or its new content."""
    beside = path.with_name(f".{path.name}.new")
    try:
        with beside.open("wb") as file:
            file.write(content.encode() if isinstance(content, str) else content)
            file.flush()
            os.fsync(file.fileno())
        move(beside, path)
    except OSError as error:
        with contextlib.suppress(OSError):
            beside.unlink(missing_ok=True)
        raise OSError(error.errno, error.strerror, str(path)) from error  # that of a full disk names no file


def put_copy(path: Path, source: Path) -> None:
    """Copy a file atomically, unless a copy is there."""
    known, found = source.stat(), path.stat() if path.exists() else None
    if found is not None and (found.st_size, found.st_mtime_ns) == (known.st_size, known.st_mtime_ns):
        return
    beside = path.with_name(f".{path.name}.new")
    try:
        shutil.copy2(source, beside)
        move(beside, path)
    finally:
        beside.unlink(missing_ok=True)


def move(path: Path, to: Path) -> None:
    """Rename a file, replacing an existing one, and make the new name durable."""
    path.replace(to)
    folder = os.open(to.parent, os.O_RDONLY)
    try:
        os.fsync(folder)
    finally:
        os.close(folder)
