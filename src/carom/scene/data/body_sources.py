"""Where a scene finds the bodies of its [[bodies]]: data files, arrays, or a recording."""

from __future__ import annotations

import contextlib
import hashlib
import stat
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple, Protocol

from carom.errors import SceneError
from carom.scene.data.body_columns import BodyColumns, read_columns
from carom.scene.data.formats import MotionLaw, open_table
from carom.scene.schema.body import BodyData
from carom.scene.schema.contact import Material
from carom.scene.units.system import SI, UnitSystem

LARGEST_DATA = 10**11  # bytes; a digest of them takes a minute


class SourcedBodies(NamedTuple):
    """Bodies, and the digest of what they were read from."""

    columns: BodyColumns
    sha256: str
    material: Material | None = None  # that gave them a density, if that is known
    notes: tuple[str, ...] = ()  # sentences on what of it is not used, or read in another way
    law: MotionLaw | None = None  # what moved them where they come from, if that is known


@dataclass(frozen=True)
class Wanted:
    """The [[bodies]] whose bodies are to be found."""

    section: BodyData
    index: int  # among those of the scene
    first: int  # number of its first body in the scene
    row: int  # likewise, among the bodies of all [[bodies]]
    units: UnitSystem  # of the numbers in files
    material: Material | None = None  # of the section


class BodySource(Protocol):
    """Finds the bodies of each [[bodies]] of a scene."""

    def find(self, wanted: Wanted) -> SourcedBodies:
        """Return the bodies of a section; SceneError if they cannot be found."""


@dataclass(frozen=True)
class DataFiles:
    """Files, relative to the folder of the scene."""

    folder: Path

    def find(self, wanted: Wanted) -> SourcedBodies:
        """Read a file, if it is the one whose digest the scene has."""
        section = wanted.section
        if section.file is None:
            arrays = "; the scene was made of arrays in Python" if section.sha256 else ""
            raise SceneError(f"file is missing: the name of the data file{arrays}")
        path = self.folder / section.file
        try:
            _refuse_what_is_no_file(path, section.file)
            digest = _digest(path)
        except SceneError:
            raise
        except IsADirectoryError:
            raise SceneError(f"{section.file}: a folder, not a data file") from None
        except (OSError, ValueError) as error:  # a name with a zero byte is a ValueError
            reason = getattr(error, "strerror", None) or str(error)
            raise SceneError(f"{path}: cannot be read: {reason}") from None
        if section.sha256 not in (None, digest):
            raise SceneError(
                f"{section.file} has changed: its sha256 is {digest[:12]}… and that of the scene "
                f"{str(section.sha256)[:12]}…; restore the file, or remove sha256 and count"
            )
        table = open_table(path, section.file, section.snapshot)
        columns, notes = read_columns(section, table, wanted.units, wanted.material)
        return SourcedBodies(columns, digest, wanted.material, notes, table.law)


def changed_files(sections: Iterable[BodyData], folders: Sequence[Path]) -> list[str]:
    """Return the names of data files that are in one of the folders and have another digest than the scene says."""
    found = list[str]()
    for section in sections:
        path = next(
            (folder / section.file for folder in folders if section.file and (folder / section.file).is_file()), None
        )
        with contextlib.suppress(OSError):
            if path is not None and path.stat().st_size <= LARGEST_DATA and _digest(path) != section.sha256:
                found.append(str(section.file))
    return found


def _refuse_what_is_no_file(path: Path, called: str) -> None:
    """Refuse what would have no end, or block, and files that nobody means: they are read several times."""
    found = path.stat()
    if stat.S_ISDIR(found.st_mode):
        raise IsADirectoryError
    if not stat.S_ISREG(found.st_mode):
        raise SceneError(f"{called}: a device or a pipe; give a file, since data are read more than once")
    if found.st_size > LARGEST_DATA:
        raise SceneError(f"{called}: {found.st_size} bytes are too many; at most {LARGEST_DATA}")


def _digest(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


@dataclass(frozen=True)
class HeldBodies:
    """Bodies that are in memory, of a scene from files, arrays or a recording.

    Parameters
    ----------
    sections
        The [[bodies]] that they were read for.
    found
        The bodies of each.
    units
        The units that the scene's numbers had.
    files
        The files that they were read from, for sections that are changed; None if they came from no file.
    """

    sections: tuple[BodyData, ...]
    found: tuple[SourcedBodies, ...]
    units: UnitSystem = SI
    files: DataFiles | None = field(default=None, compare=False)

    def find(self, wanted: Wanted) -> SourcedBodies:
        """Return the bodies, or read the file again if the scene says something else about it now."""
        known = wanted.index < len(self.sections) and wanted.section.is_like(self.sections[wanted.index])
        if known and wanted.units == self.units:
            found = self.found[wanted.index]
            if found.material in (None, wanted.material):
                return found
        if self.files is None:
            raise SceneError("it cannot be changed, because its file is not at hand: only its name can")
        return self.files.find(wanted)
