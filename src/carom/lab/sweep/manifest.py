"""The folder of a sweep, and its manifest: a file with the outcome of each run, valid at any time."""

from __future__ import annotations

import contextlib
import errno
import json
import os
import re
import shutil
import uuid
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, Self

from pydantic import AfterValidator, BaseModel, Field, ValidationError, model_validator

from carom.errors import ExperimentError
from carom.lab.sweep.plan import SEED, Plan, SweepPoint
from carom.recording.write.durable_sink import DiskReserve
from carom.recording.write.whole_file import is_link_of_another, lock, new_name, output_folder
from carom.runs.environment import versions
from carom.scene.scene_file import DEEPEST, is_too_deep

# a recording that is being written, or the lock of such a recording
_ATTEMPT = re.compile(r"\.?(.+)\.[0-9a-f]{8}\.rrd(\.\w+)?")
NO_ROOM = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)


class Folder:
    """The paths of a sweep."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self.scene = root / "scene.toml"  # scene of all runs, without the varied values
        self.data = root / "data"  # copies of the data files that the scene reads
        self.manifest = root / "manifest.json"  # the outcomes of all runs
        self.tables = root / "table.parquet", root / "table.csv"  # the summary
        self.recordings = root / "runs", root / "failed"
        self.partial = root / "partial"  # recordings being written
        self._lock = root / ".claim"

    def whole(self, name: str) -> Path:
        """Return the path of the recording of a completed run."""
        return self.recordings[0] / f"{name}.rrd"

    def failed(self, name: str) -> Path:
        """Return the path of the recording of a failed run."""
        return self.recordings[1] / f"{name}.rrd"

    def attempt(self, name: str) -> Path:
        """Return a unique path for writing a recording, even among attempts at the same run."""
        return self.partial / f"{name}.{uuid.uuid4().hex[:8]}.rrd"

    def make(self) -> None:
        """Make the folder and its subfolders."""
        for part in (self.root, *self.recordings, self.partial):
            output_folder(part)

    def refuse_links(self) -> None:
        """Refuse a folder in which another user has replaced a subfolder by a link."""
        for part in (*self.recordings, self.partial, self.data):
            if is_link_of_another(part):
                raise ExperimentError(f"{part}: a link of another user; choose another folder with -o")

    @property
    def is_fresh(self) -> bool:
        """Whether the folder contains only the lock."""
        return all(path == self._lock for path in self.root.iterdir())

    def leave(self) -> None:
        """Remove the empty folders of a sweep that could not begin."""
        self.remove_empty()
        self._lock.unlink(missing_ok=True)
        with contextlib.suppress(OSError):
            self.root.rmdir()

    def remove_empty(self) -> None:
        """Remove subfolders without files."""
        for folder in (*self.recordings, self.partial, self.data):
            with contextlib.suppress(OSError):
                folder.rmdir()

    def clear_partial(self, names: Iterable[str]) -> None:
        """Remove leftovers of earlier attempts at runs of these names."""
        ours = set(names)
        with contextlib.suppress(FileNotFoundError, NotADirectoryError):
            for path in self.partial.iterdir():
                attempt = _ATTEMPT.fullmatch(path.name)
                if attempt and attempt[1] in ours:
                    path.unlink(missing_ok=True)

    @contextlib.contextmanager
    def claimed(self) -> Iterator[None]:
        """Lock the folder against other sweeps; the lock ends with the process.

        Raises ExperimentError if another sweep runs here.
        """
        try:
            claim = os.open(self._lock, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC, 0o666)
        except OSError as error:
            raise ExperimentError(f"{self._lock}: cannot be opened: {error.strerror}; choose another folder") from None
        try:
            try:
                lock(claim)
            except BlockingIOError:
                raise ExperimentError(
                    f"{self.root}: another sweep is running in this folder; wait for it, or end it"
                ) from None
            yield
        finally:
            os.close(claim)


def put(path: Path, content: str | bytes) -> None:
    """Write a file atomically: after a crash, it has its old or its new content."""
    try:
        with new_name(path, ".new") as beside:
            with beside.open("xb") as file:
                file.write(content.encode() if isinstance(content, str) else content)
                file.flush()
                os.fsync(file.fileno())
            move(beside, path)
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(path)) from error  # the error for a full disk names no file


def put_copy(path: Path, source: Path) -> None:
    """Copy a file atomically, unless the copy exists."""
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


def _inside(name: str) -> str:
    """Return the path of a file below the sweep's folder. Raises ValueError if the path leads out of the folder."""
    path = Path(name)
    if name and (path.is_absolute() or ".." in path.parts or path == Path() or "\0" in name):
        raise ValueError(f"{name[:80]!r} is not a file below the folder of the sweep")
    return name


def _plain(name: str) -> str:
    """Return the name of a run. Raises ValueError if the text is not the name of a file."""
    if Path(name).name != name or name in ("", ".", "..") or "\0" in name:
        raise ValueError(f"{name[:80]!r} is not the name of a run")
    return name


Inside = Annotated[str, AfterValidator(_inside)]
Plain = Annotated[str, AfterValidator(_plain)]

SCHEMA = 1
PENDING, DONE, FAILED = "pending", "done", "failed"
COMPLETED = "completed"
_ENTRY = 4000  # bytes reserved for each run's entry


@dataclass(frozen=True, slots=True)
class SweepRun:
    """One run and its outcome."""

    name: Plain
    parameters: dict[str, Any]
    seed: int
    status: str = PENDING  # "done": run and recording are complete; "failed": the run or the recording is incomplete
    outcome: str = ""  # a status of `Outcome`, or "refused", "error", or "lost" if its workers died
    reason: str = ""  # a sentence; empty when completed
    wall_time: float | None = None  # s
    fingerprint: str = ""  # fingerprint of the last frame, 16 hexadecimal digits
    file: Inside = ""  # path of the recording in the sweep's folder
    size: int = 0  # bytes
    worker: str = ""  # the host that ran it
    results: dict[str, Any] = field(default_factory=dict)  # the numbers that `carom inspect` prints, under dotted keys

    @property
    def ok(self) -> bool:
        """Whether the run completed and kept its promises."""
        return self.outcome == COMPLETED


class StoredSweep(BaseModel):
    """Content of a manifest; unknown keys are ignored."""

    title: str
    scene: str  # digest of the scene
    varied: list[str]
    versions: dict[str, str]
    counts: dict[str, int]  # numbers of runs, by status
    units: str
    files: list[Inside]
    runs: Annotated[list[SweepRun], Field(min_length=1)]

    @model_validator(mode="after")
    def _each_run_has_what_varies(self) -> Self:
        for run in self.runs:
            for key in self.varied:
                if key not in run.parameters and key != SEED:  # each run has a seed
                    raise ValueError(f"run {run.name[:80]!r} has no value of {key[:80]!r}, which varies")
        return self


class Manifest:
    """The list of all runs, stored in the folder of a sweep."""

    def __init__(
        self, folder: Folder, plan: Plan, runs: dict[str, SweepRun], command: str, files: Iterable[str] = ()
    ) -> None:
        self.folder = folder
        self.plan = plan
        self.runs = runs  # runs by name
        self.command = command
        self.files = set(files)  # further files of the sweep in its folder
        self._lines = {name: _line(run) for name, run in runs.items()}  # lines of the file, by name of the run
        self._reserve: DiskReserve | None = None

    @classmethod
    def begin(cls, folder: Folder, plan: Plan, command: str) -> Self:
        """Continue a sweep, or begin one; completed runs are kept.

        Raises ExperimentError if the folder holds another scene, or a sweep with another scene, other keys or another
        version of carom.
        """
        known: dict[str, SweepRun] = {}
        files: set[str] = set()
        if folder.manifest.exists():
            stored = read(folder)
            # a folder must not mix two sweeps
            remedy = "choose another folder with -o, or remove that sweep and start over with --force"
            if stored.scene != plan.digest:
                raise ExperimentError(
                    f"{folder.root}: holds a sweep of another scene ({folder.scene} has it); {remedy}"
                )
            if tuple(stored.varied) != plan.varied:
                keys = ", ".join(stored.varied)
                raise ExperimentError(f"{folder.root}: holds a sweep that varies {keys}, in this order; {remedy}")
            theirs, ours = stored.versions.get("carom", "unknown"), versions()["carom"]
            if theirs != ours:
                raise ExperimentError(f"{folder.root}: was begun with carom {theirs}, this is {ours}; {remedy}")
            known, files = {run.name: run for run in stored.runs}, set(stored.files)
        data = [str(Path(folder.data.name) / name) for name in plan.files]
        # files that the manifest does not list are not replaced
        names = [folder.scene.name, *(path.name for path in folder.tables), *data]
        for name in names:
            if name not in files and os.path.lexists(folder.root / name):
                raise ExperimentError(
                    f"{folder.root / name}: the sweep would replace it; choose another folder with -o"
                )
        unlisted = {point.name for point in plan.points} - known.keys()
        for path in (path for place in folder.recordings for path in place.glob("*.rrd")):
            if path.name.removesuffix(".rrd") in unlisted:
                raise ExperimentError(
                    f"{path}: it belongs to no sweep, and this sweep would replace it; choose another folder with -o"
                )
        for point in plan.points:
            known.setdefault(point.name, SweepRun(point.name, point.parameters, point.seed))
        begun = cls(folder, plan, known, command, files | {folder.scene.name, *data})
        folder.make()
        # the manifest is written before the files that it lists, so that every file of a sweep has a manifest
        begun.save()
        # the data files of the scene are copied, for workers on other machines and for later use
        for name, source in plan.files.items():
            target = folder.data / name
            output_folder(target.parent)
            try:
                put_copy(target, source)
            except OSError as error:
                raise ExperimentError(f"{source}: cannot be copied to {target}: {error.strerror}") from None
        put(folder.scene, plan.scene)
        return begun

    @property
    def todo(self) -> list[SweepPoint]:
        """The runs of the plan that are missing or failed."""
        missing = []
        for point in self.plan.points:
            run = self.runs[point.name]
            path = self.folder.root / run.file
            if run.status != DONE or not path.is_file() or path.stat().st_size != run.size:
                missing.append(point)
        return missing

    @property
    def asked(self) -> list[SweepRun]:
        """The runs of the plan; the folder may hold more from an earlier, larger plan."""
        return [self.runs[point.name] for point in self.plan.points]

    def reset(self, points: list[SweepPoint]) -> None:
        """Reset runs to their initial state."""
        for point in points:
            self._enter(SweepRun(point.name, point.parameters, point.seed))

    def enter(self, name: str, report: dict[str, Any]) -> SweepRun:
        """Enter the report of a worker on a run: fields of `SweepRun`."""
        run = replace(self.runs[name], **report)
        self._enter(run)
        return run

    def list_tables(self) -> None:
        """Record that the tables belong to this sweep. Raises OSError if another file has a table's name."""
        names = {path.name for path in self.folder.tables}
        for name in sorted(names - self.files):
            if os.path.lexists(self.folder.root / name):
                raise FileExistsError(
                    errno.EEXIST, "it does not belong to this sweep; move it", str(self.folder.root / name)
                )
        self.files |= names
        self.save()

    def hold_room(self) -> None:
        """Reserve disk space for the final manifest, so that it can report a full disk."""
        self._reserve = DiskReserve(self.folder.root)
        try:
            self._reserve.grow(_ENTRY * len(self.runs))
        except OSError as error:
            self._reserve.release()
            raise ExperimentError(
                f"{self.folder.root}: cannot reserve disk space for the sweep: {error.strerror}"
            ) from None

    def save(self) -> None:
        """Write the file. Raises OSError if that fails; the previous file then remains."""
        about = {
            "schema": SCHEMA,
            "title": self.plan.title,
            "scene": self.plan.digest,
            "varied": list(self.plan.varied),
            "units": self.plan.units,
            "versions": versions(),
            "command": self.command,
            "files": sorted(self.files),
            "counts": dict(Counter(run.status for run in self.runs.values())),
        }
        head = json.dumps(about, indent=1, ensure_ascii=False).removesuffix("\n}")
        text = f'{head},\n "runs": [\n' + ",\n".join(self._lines.values()) + "\n]}\n"
        try:
            put(self.folder.manifest, text)
        except OSError as error:
            if error.errno not in NO_ROOM or self._reserve is None:
                raise
            self._reserve.release()
            self._reserve = None
            put(self.folder.manifest, text)

    def _enter(self, run: SweepRun) -> None:
        self.runs[run.name] = run
        self._lines[run.name] = _line(run)


def read(folder: Folder) -> StoredSweep:
    """Read a stored manifest. Raises ExperimentError if there is no manifest, or it is not one of carom's."""
    path = folder.manifest
    if not path.is_file():
        raise ExperimentError(f"{folder.root}: not a sweep (it contains no {path.name})")
    try:
        text = path.read_text(encoding="utf-8")
        stored = json.loads(text, parse_int=_int64)
        if not isinstance(stored, dict) or is_too_deep(stored):
            raise ValueError(f"expected an object of at most {DEEPEST} levels")
        if stored.get("schema") != SCHEMA:
            raise ExperimentError(f"{path}: of another version of carom (schema {str(stored.get('schema'))[:20]})")
        return StoredSweep.model_validate_json(text, strict=True)
    except OSError as error:
        raise ExperimentError(f"{path}: cannot be read: {error.strerror}") from None
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        where, told = ".".join(map(str, first["loc"])) or "runs", first["msg"].removeprefix("Value error, ")
        raise ExperimentError(f"{path}: not a manifest of carom's: {where}: {told}") from None
    except (ValueError, RecursionError) as error:
        raise ExperimentError(f"{path}: not a manifest of carom's: {type(error).__name__}: {error}") from None


def _int64(digits: str) -> int:
    """Read a whole number that fits into a table."""
    value = int(digits)
    if not -(2**63) <= value < 2**63:
        raise ValueError(f"{digits[:20]}…: a whole number of more than 64 bits")
    return value


def clear(folder: Folder) -> None:
    """Remove only the runs and files that the manifest of a folder lists, and finally the manifest."""
    stored = read(folder)
    ours = {run.name for run in stored.runs}
    folder.clear_partial(ours)
    for path in (path for place in folder.recordings for path in place.glob("*.rrd")):
        if path.name.removesuffix(".rrd") in ours and not path.is_dir():
            path.unlink()
    for name in stored.files:
        path = folder.root / name
        if path.name != name and not path.parent.resolve().is_relative_to(folder.root.resolve()):
            continue  # outside of this folder
        path.unlink(missing_ok=True)
        for above in path.parents[: len(path.parts) - len(folder.root.parts) - 1]:
            with contextlib.suppress(OSError):
                above.rmdir()
    folder.manifest.unlink(missing_ok=True)
    folder.remove_empty()


def _line(run: SweepRun) -> str:
    """Return the entry of a run as text, which is cached until the run changes."""
    return json.dumps(asdict(run), ensure_ascii=False)
