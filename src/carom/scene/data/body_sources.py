"""Sources of the bodies in [[bodies]] tables: data files, arrays, or a recording."""

from __future__ import annotations

import contextlib
import hashlib
import math
import stat
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import numpy as np

from carom.errors import SceneError
from carom.scene.data import MotionLaw, open_table
from carom.scene.data.body_columns import BodyColumns, read_columns
from carom.scene.data.facts import Facts, FileBox, contradiction
from carom.scene.data.orbital_elements import Centre
from carom.scene.schema.body import BodyData
from carom.scene.schema.contact import Material
from carom.scene.units.dimension import GRAVITATIONAL_CONSTANT, LENGTH, TIME
from carom.scene.units.system import SI, UnitSystem

if TYPE_CHECKING:
    from carom.scene.schema import SceneModel

LARGEST_DATA = 10**11  # bytes; computing their digest takes a minute
LAW = {"constant": GRAVITATIONAL_CONSTANT, "softening": LENGTH}  # keys of [gravity] that a file may state
_SAME_LAW = 1e-9  # relative difference that is due to the number of digits written


class SourcedBodies(NamedTuple):
    """Bodies, and the digest of their source."""

    columns: BodyColumns
    sha256: str
    material: Material | None = None  # material that defined their density, if known
    notes: tuple[str, ...] = ()  # notes on parts of the source that are unused or reinterpreted
    law: MotionLaw | None = None  # law of motion in the source, if known
    facts: Facts = Facts()  # what the source states about its numbers
    centre: Centre | None = None  # of the orbits, if they come from orbital elements


@dataclass(frozen=True)
class Wanted:
    """The [[bodies]] table whose bodies are requested."""

    section: BodyData
    index: int  # its number among the [[bodies]] tables of the scene
    first: int  # number of its first body in the scene
    row: int  # number of its first body among the bodies of all [[bodies]]
    units: UnitSystem  # units of the numbers in files
    material: Material | None = None  # of the section
    centre: Centre | None = None  # of the orbits, if the section has any


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
            raise SceneError(f"file is missing: the name of the data file{arrays}")
        path = self.folder / section.file
        try:
            # refuse endless and blocking files, and oversized ones, because files are read several times
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
        except (OSError, ValueError) as error:  # a name with a zero byte is a ValueError
            reason = getattr(error, "strerror", None) or str(error)
            raise SceneError(f"{path}: cannot be read: {reason}") from None
        if section.sha256 not in (None, digest):
            raise SceneError(
                f"{section.file} has changed: its sha256 is {digest[:12]}… and that of the scene "
                f"{str(section.sha256)[:12]}…; restore the file, or remove sha256 and count"
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
    bodies: tuple[SourcedBodies, ...]  # of each table
    units: UnitSystem = SI  # of the scene's numbers
    files: DataFiles | None = field(default=None, compare=False)  # read again if a table changes; None without files

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


def take_over_laws(
    scene: SceneModel, units: UnitSystem, given: Mapping[str, Any], each_bodies: list[SourcedBodies]
) -> tuple[dict[str, float], dict[int, str]]:
    """Compare the laws of motion in the files with the scene; add notes to the bodies in ``each_bodies``.

    Parameters
    ----------
    given
        The section [gravity] as written.

    Returns
    -------
    taken, refuted
        Plain numbers for keys of [gravity] that a file states and the scene does not; contradictions between a file and
        the scene or another file, by the index of the file's [[bodies]] table.
    """
    is_off = scene.gravity.method == "none" or ("constant" in given and scene.gravity.constant == 0.0)
    taken, refuted = dict[str, float](), dict[int, str]()
    for index, bodies in enumerate(each_bodies):
        law, notes = bodies.law, list[str]()
        if law is None:
            continue
        if is_off and law.constant > 0.0:
            notes.append(f"G = {law.constant:g} is not used, because the scene has no gravity between bodies")
        for key, dimension in () if is_off else LAW.items():
            number = float(getattr(law, key))
            if key not in given and key not in taken and (number > 0.0 or key == "constant"):
                taken[key] = number
            own = taken.get(key, units.shown(getattr(scene.gravity, key), dimension))
            if taken.get(key) == number:
                notes.append(f"gravity.{key} = {number:g} is taken from it")
            elif number == 0.0 and key == "softening" and own > 0.0:
                notes.append(f"it has no softening, but the scene has {own:g}")
            elif not math.isclose(own, number, rel_tol=_SAME_LAW):
                remedy = f"leave gravity.{key} out, or set that"
                refuted[index] = f"gravity.{key} is {number!r} in it, but {own!r} here; {remedy}"
        x, y, z = law.ghosts
        images = f"N_ghost_x, N_ghost_y, N_ghost_z = {x}, {y}, {z}"
        if law.constant > 0.0 and not is_off and any(law.ghosts):
            copies = f"{2 * x + 1} × {2 * y + 1} × {2 * z + 1} copies"
            refuted.setdefault(
                index,
                f"{images}: each of its particles attracts {copies} of the others, but here each body once; set "
                "gravity.constant = 0, or N_ghost_x = N_ghost_y = N_ghost_z = 0 in REBOUND",
            )
        elif law.collides and scene.contact.enabled and _differs_in_ghosts(law, bodies.facts):
            notes.append(
                f"{images}: its bodies meet those many copies of each other, but here the nearest copy in a periodic "
                "box, and none in open space"
            )
        if law.integrated and scene.time.integrator != (law.integrator or None):
            known = f'time.integrator = "{law.integrator}" is this method'
            notes.append(
                f"{law.integrated} is not taken over; {known if law.integrator else 'carom lacks this method'}"
            )
        if not law.collides and scene.contact.enabled:
            notes.append("its bodies pass through each other; contact.enabled = false does the same here")
        _add_notes(scene, index, each_bodies, notes)
    return taken, refuted


def compare_facts(scene: SceneModel, units: UnitSystem, each_bodies: list[SourcedBodies]) -> dict[int, str]:
    """Compare what the files state with the scene and with each other; add notes to the bodies in ``each_bodies``.

    Return contradictions by the index of the [[bodies]] table.
    """
    refuted = dict[int, str]()
    for index, bodies in enumerate(each_bodies):
        for before in range(index):
            other = scene.bodies[before].called
            if differs := contradiction(bodies.facts, other, each_bodies[before].facts):
                refuted.setdefault(index, differs)
            now, then = bodies.facts.time, each_bodies[before].facts.time
            if now is not None and then is not None and not math.isclose(now, then, rel_tol=_SAME_LAW):
                note = f"its time is {units.text(now, TIME)}, and that of {other} is {units.text(then, TIME)}"
                _add_notes(scene, index, each_bodies, [note])
        box = bodies.facts.box
        if box is None:
            continue
        low, size = ([units.shown(each, LENGTH) for each in values] for values in (box.low, box.size))
        shown = " × ".join(f"{each:g}" for each in size)
        own = scene.domain.size or (0.0, 0.0, 0.0)
        alike = [math.isclose(a, b, rel_tol=_SAME_LAW) for a, b in zip(own, box.size, strict=True)]
        open_axes = [axis for k, axis in enumerate("xyz") if axis in box.periodic and k not in scene.domain.repeating]
        if bodies.law is not None and box.periodic and (open_axes or not all(alike)):
            refuted[index] = (
                f'its box is periodic; set domain.boundary = "periodic" and domain.size = '
                f"[{', '.join(f'{each:g}' for each in size)}]"
            )
        elif open_axes:
            wanted = '"periodic"' if box.periodic == "xyz" else _quoted_axes(box)
            along = "" if box.periodic == "xyz" else f" along {' and '.join(box.periodic)}"
            note = f"its box of {shown} is periodic{along}, which is ignored; set domain.boundary = {wanted} for that"
            _add_notes(scene, index, each_bodies, [note])
        elif any(axis in box.periodic and not same for axis, same in zip("xyz", alike, strict=True)):
            mine = " × ".join(f"{units.shown(each, LENGTH):g}" for each in own)
            _add_notes(scene, index, each_bodies, [f"its periodic box is {shown}, and domain.size is {mine}"])
        # bodies beyond the walls, because the program has its box elsewhere
        half = 0.5 * np.array(own)
        beyond: list[bool] = np.any(np.abs(bodies.columns.position) > half, axis=0).tolist()
        if any(beyond[axis] for axis in scene.domain.walled) and scene.bodies[index].origin is None:
            middle = [a + 0.5 * b for a, b in zip(low, size, strict=True)]
            ends = [f"{a:g} to {a + b:g}" for a, b in zip(low, size, strict=True)]
            refuted[index] = (
                f"its box is {' × '.join(ends)}, and the walls of domain are about the origin; write origin = "
                f"[{', '.join(f'{each:g}' for each in middle)}] in [[bodies]]"
            )
    return refuted


def _quoted_axes(box: FileBox) -> str:
    """Return the boundary along each axis as a list for a scene."""
    return str(["periodic" if axis in box.periodic else "open" for axis in "xyz"]).replace("'", '"')


def _add_notes(scene: SceneModel, index: int, each_bodies: list[SourcedBodies], notes: Iterable[str]) -> None:
    """Add notes to the bodies of a table; a changed scene already has its earlier notes."""
    bodies, called = each_bodies[index], scene.bodies[index].called
    new = [f"{called}: {note}" for note in notes]
    each_bodies[index] = bodies._replace(notes=(*bodies.notes, *(note for note in new if note not in bodies.notes)))


def _differs_in_ghosts(law: MotionLaw, facts: Facts) -> bool:
    """Return whether bodies meet across the faces of the box in REBOUND only, or here only."""
    return any(law.ghosts) if facts.box is None else not all(law.ghosts)
