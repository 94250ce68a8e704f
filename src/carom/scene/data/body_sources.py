"""Sources of the bodies in [[bodies]] tables: data files, arrays, or a recording."""

from __future__ import annotations

import contextlib
import hashlib
import stat
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple, Protocol

from carom.errors import SceneError
from carom.scene.data import MotionLaw, open_table
from carom.scene.data.body_columns import BodyColumns, read_columns
from carom.scene.data.facts import Facts
from carom.scene.data.orbital_elements import Centre
from carom.scene.schema.body import BodyData
from carom.scene.schema.contact import Material
from carom.scene.units.dimension import TIME
from carom.scene.units.system import SI, UnitSystem

LARGEST_DATA = 10**11  # largest size of a file in bytes; computing its digest takes a minute


class SourcedBodies(NamedTuple):
    """Bodies, and the digest of their source."""

    columns: BodyColumns
    sha256: str
    material: Material | None = None  # material that determined the density, if known
    notes: tuple[str, ...] = ()  # notes on parts of the source that are unused or reinterpreted
    law: MotionLaw | None = None  # law of motion that the source states, if any
    facts: Facts = Facts()  # statements of the source about its numbers
    centre: Centre | None = None  # centre of the orbits, if positions come from orbital elements


@dataclass(frozen=True)
class Wanted:
    """The [[bodies]] table whose bodies are requested."""

    section: BodyData
    index: int  # number of the table among the scene's [[bodies]] tables
    first: int  # number of the table's first body in the scene
    row: int  # number of the table's first body among the bodies of all [[bodies]]
    units: UnitSystem  # units of the numbers in files
    material: Material | None = None  # material of the section
    centre: Centre | None = None  # centre of the orbits, if the section has one


class BodySource(Protocol):
    """Finds the bodies of each [[bodies]] table of a scene."""

    def find(self, wanted: Wanted) -> SourcedBodies:
        """Return the bodies of a table; raises SceneError if they are not available."""


@dataclass(frozen=True)
class DataFiles:
    """Files, relative to the folder of the scene."""

    folder: Path

    def find(self, wanted: Wanted) -> SourcedBodies:
        """Read a file, and check its digest if the scene states one."""
        section = wanted.section
        if section.file is None:
            arrays = "; the scene was made from arrays in Python" if section.sha256 else ""
            raise SceneError(f"the key file is missing; it is the name of the data file{arrays}")
        path = self.folder / section.file
        try:
            # refuse endless, blocking and oversized files, because files are read several times
            status = path.stat()
            if stat.S_ISDIR(status.st_mode):
                raise SceneError(f"{section.file}: a folder, not a data file")
            if not stat.S_ISREG(status.st_mode):
                raise SceneError(f"{section.file}: a device or a pipe; name a file, since data are read more than once")
            if status.st_size > LARGEST_DATA:
                raise SceneError(f"{section.file}: {status.st_size} bytes are too many; at most {LARGEST_DATA}")
            digest = _digest(path)
        except SceneError:
            raise
        except (OSError, ValueError) as error:  # a name with a zero byte raises a ValueError
            reason = getattr(error, "strerror", None) or str(error)
            raise SceneError(f"{path}: cannot be read: {reason}") from None
        if section.sha256 not in (None, digest):
            raise SceneError(
                f"{section.file} has changed: its sha256 is {digest[:12]}…, not "
                f"{str(section.sha256)[:12]}… as in the scene; restore the file, or remove sha256 and count"
            )
        time = None if section.snapshot_time is None else wanted.units.shown(section.snapshot_time, TIME)
        table = open_table(path, section.file, section.snapshot, section.columns.header, time)
        columns, notes, facts = read_columns(section, table, wanted.units, wanted.material, wanted.centre)
        return SourcedBodies(columns, digest, wanted.material, notes, table.law, facts, wanted.centre)


def changed_files(sections: Iterable[BodyData], folders: Sequence[Path]) -> list[str]:
    """Return the names of the data files in these folders whose digests differ from the scene's."""
    changed = list[str]()
    for section in sections:
        paths = [folder / section.file for folder in folders if section.file]
        path = next(filter(Path.is_file, paths), None)
        with contextlib.suppress(OSError):
            if path is not None and path.stat().st_size <= LARGEST_DATA and _digest(path) != section.sha256:
                changed.append(str(section.file))
    return changed


def _digest(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


@dataclass(frozen=True)
class HeldBodies:
    """Bodies of a scene that are already in memory, from files, arrays or a recording."""

    sections: tuple[BodyData, ...]  # the [[bodies]] tables of these bodies
    bodies: tuple[SourcedBodies, ...]  # bodies of each table
    units: UnitSystem = SI  # units of the scene's numbers
    # files that are read again if a table changes; None without files
    files: DataFiles | None = field(default=None, compare=False)

    def find(self, wanted: Wanted) -> SourcedBodies:
        """Return the bodies; read the file again if its table or the units have changed."""
        known = wanted.index < len(self.sections) and wanted.section.is_like(self.sections[wanted.index])
        if known and wanted.units == self.units:
            bodies = self.bodies[wanted.index]
            if bodies.material in (None, wanted.material) and bodies.centre in (None, wanted.centre):
                return bodies
        if self.files is None:
            raise SceneError("only its name can be changed, because its file is not available")
        return self.files.find(wanted)
