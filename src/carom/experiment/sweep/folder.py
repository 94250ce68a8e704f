"""Where a sweep lives: one folder, the same for whoever starts it and for whoever computes."""

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
        """The scene that all runs start from, without what varies."""
        return self.root / "scene.toml"

    @property
    def manifest(self) -> Path:
        """What became of each run."""
        return self.root / "manifest.json"

    @property
    def table(self) -> Path:
        """The summary as Parquet; the same as CSV lies beside it."""
        return self.root / "table.parquet"

    @property
    def partial(self) -> Path:
        """Recordings being written."""
        return self.root / "partial"

    def whole(self, name: str) -> Path:
        """Return where the recording of a run lies that went to its end."""
        return self.root / "runs" / f"{name}.rrd"

    def failed(self, name: str) -> Path:
        """Return where the recording of a run lies that failed: everything up to then."""
        return self.root / "failed" / f"{name}.rrd"

    def attempt(self, name: str) -> Path:
        """Return where to write a recording that nobody else writes, not even another attempt at the same run."""
        return self.partial / f"{name}.{uuid.uuid4().hex[:8]}.rrd"

    def make(self) -> None:
        """Make the folder and those in it."""
        for part in (self.root, self.root / "runs", self.root / "failed", self.partial):
            output_folder(part)

    def clear_partial(self) -> None:
        """Remove what attempts left that nobody waits for any more."""
        for path in self.partial.iterdir():
            path.unlink(missing_ok=True)

    def clear(self) -> None:
        """Remove all that a sweep put here, and nothing else."""
        for part in ("runs", "failed", "partial"):
            shutil.rmtree(self.root / part, ignore_errors=True)
        for path in (self.manifest, self.scene, self.table, self.table.with_suffix(".csv")):
            path.unlink(missing_ok=True)

    @contextlib.contextmanager
    def claimed(self) -> Iterator[None]:
        """Keep other sweeps out of the folder; the claim ends with the process, however it ends.

        Raises
        ------
        ExperimentError
            If another sweep runs here.
        """
        with (self.root / ".claim").open("w") as claim:
            try:
                fcntl.flock(claim, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError:
                raise ExperimentError(f"{self.root}: another sweep runs here; wait for it, or end it") from None
            yield


def put(path: Path, content: str | bytes) -> None:
    """Write a file so that it is there as before or as a whole, whenever the machine stops."""
    beside = path.with_name(f".{path.name}.new")
    try:
        with beside.open("wb") as file:
            file.write(content.encode() if isinstance(content, str) else content)
            file.flush()
            os.fsync(file.fileno())
        move(beside, path)
    except OSError:
        with contextlib.suppress(OSError):
            beside.unlink(missing_ok=True)
        raise


def move(path: Path, to: Path) -> None:
    """Rename a file, in place of one that is there, and make the new name durable."""
    path.replace(to)
    folder = os.open(to.parent, os.O_RDONLY)
    try:
        os.fsync(folder)
    finally:
        os.close(folder)
