"""Scenes from TOML, from dictionaries and from arrays, with errors that name file, line and key."""

from __future__ import annotations

import copy
import re
import tomllib
import warnings
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
import tomlkit
from numpy.typing import ArrayLike
from pydantic import ValidationError

from carom.errors import SceneError
from carom.scene.conversion import converted, unit_system
from carom.scene.data.body_columns import columns_of_arrays
from carom.scene.data.body_sources import (
    BodySource,
    DataFiles,
    HeldBodies,
    SourcedBodies,
    Wanted,
)
from carom.scene.data.orbital_elements import Centre
from carom.scene.explanation import explain, is_known, meant_by, not_a_quantity, with_words, written_path
from carom.scene.file_statements import LAW, compare_facts, take_over_laws
from carom.scene.matter import body_mass, made_of, material_called
from carom.scene.overrides import OldNameWarning, apply_override, apply_overrides, old_names
from carom.scene.scene_file import (
    DEEPEST,
    LARGEST_FILE,
    KeyPath,
    KeyPlaces,
    is_too_deep,
    line_of_long_key,
    read_text,
    scene_path,
    toml_text,
)
from carom.scene.scene_model import SceneModel, know_installed_parts
from carom.scene.schema.body import BodyData
from carom.scene.schema.contact import Material
from carom.scene.schema.wall import KNOWN_SHAPES
from carom.scene.units.system import UnitSystem
from carom.scene.wall_shapes import CONTENT, shape_called
from carom.scene.wording import suggestion

_LARGEST_BESIDES_BODIES = 4_000_000  # largest number of characters of a scene, besides its bodies
_LARGEST_BODY = 1000  # largest number of characters of a [[body]] with all keys, a long name and comments
_COMMENTED = 200_000  # largest number of characters of a text whose comments survive overrides; keeping them takes 1 s
MOST_MESSAGES = 8
_MOST_DETAILS = 1000  # largest number of mistakes that are examined; a hostile text may contain a million
_TOO_DEEP = f"tables or lists nested more than {DEEPEST} levels deep"


class Scene(SceneModel):
    """A scene to simulate: validated, complete, immutable.

    Examples
    --------
    >>> scene = Scene.from_dict({"body": [{"radius": 1.0}], "time": {"duration": 1.0}})
    >>> scene.time.duration
    1.0
    """

    @classmethod
    def load(cls, source: str | Path, overrides: list[str] | None = None) -> Scene:
        """Load a TOML file, or a bundled scene by its name; see `carom.scene.load.load_scene`."""
        if not isinstance(source, str | PathLike):
            made = "; Scene.from_dict makes one from a dict" if isinstance(source, dict) else ""
            raise TypeError(f"a scene is the path of a file or a bundled name, not {type(source).__name__}{made}")
        if isinstance(overrides, str):
            raise TypeError(f'overrides are a list of texts, such as ["{overrides}"]')
        return load_scene(source, overrides or [])

    @classmethod
    def from_dict(cls, data: dict[str, Any]) -> Scene:
        """Build a scene from the same keys as a TOML file; raises `SceneError` like `load`."""
        if not isinstance(data, dict):
            raise TypeError(f"Scene.from_dict: a dict of sections is needed, not {type(data).__name__}")
        return scene_from_dict(data)

    @classmethod
    def from_arrays(
        cls,
        *,
        position: ArrayLike,
        radius: ArrayLike,
        mass: ArrayLike | None = None,
        density: ArrayLike | None = None,
        velocity: ArrayLike | None = None,
        angular_velocity: ArrayLike | None = None,
        inertia: ArrayLike | None = None,
        fixed: ArrayLike | None = None,
        name: str | ArrayLike | None = None,
        made_of: str | None = None,
        **sections: Any,
    ) -> Scene:
        """Build a scene from bodies in arrays.

        Parameters
        ----------
        position
            (n, 3) m.
        radius, mass, density, inertia, fixed
            In m, kg, kg/m³, kg m², or in the given ``units``; ``fixed``: whether a body neither moves nor rotates.
            (n,), or one value for all. A mass or a density is needed, or a material that defines one. Without
            ``inertia``, bodies are solid spheres, unless their material defines another factor.
        velocity, angular_velocity
            In m/s and rad/s; (n, 3), or (3,) for all. Zero by default.
        name
            n names, or one name to which each body adds its number.
        made_of
            The name of a [[material]] for all these bodies. `with_bodies` adds bodies of another material.
        sections
            The other keys of a scene, such as ``time={"duration": 1.0}``.

        Raises
        ------
        SceneError
            If an array has another shape or a value that is not finite, or a section is wrong.

        Examples
        --------
        >>> scene = Scene.from_arrays(position=[[0, 0, 0], [3, 0, 0]], radius=1.0, density=2600.0)
        >>> scene.count
        2
        """
        arrays = {"position": position, "radius": radius, "mass": mass, "density": density, "velocity": velocity}
        arrays |= {"angular_velocity": angular_velocity, "inertia": inertia, "fixed": fixed}
        return scene_from_arrays(arrays, name, made_of, sections)

    def with_bodies(self, *, keep: bool = False, **arrays: Any) -> Scene:
        """Return this scene with other bodies, given as for `from_arrays`.

        Parameters
        ----------
        keep
            Whether the scene keeps its own bodies and groups in addition to the new bodies.
        arrays
            ``position``, ``radius`` and so on.
        """
        return scene_with_arrays(self, keep, arrays)

    def changed(self, overrides: list[str]) -> Scene:
        """Return this scene with changed keys, in the syntax of ``--set``; raises `SceneError` like `load`."""
        if isinstance(overrides, str | Mapping):  # iteration would give the letters of a text, or the keys of a mapping
            raise TypeError(f'overrides: expected a list of texts such as ["time.duration=5"], got {overrides!r}')
        return scene_from_text(self.toml, self.title, overrides, self._held)


def load_scene(source: str | Path, overrides: list[str]) -> Scene:
    """Load a scene from a TOML file, or a bundled scene by its name, with overrides in the syntax of ``--set``.

    Raises SceneError, which states file, line and key.
    """
    path = scene_path(source)
    text = read_text(path)
    scene = scene_from_text(text, str(path), overrides, DataFiles(path.parent))
    places = KeyPlaces(str(path), text, {})
    for said in old_names(text, lambda: _parse(text, str(path)), places, overrides):
        warnings.warn(said, OldNameWarning, stacklevel=3)
    return scene


def scene_from_text(
    text: str, source: str, overrides: list[str] | None = None, bodies: BodySource | None = None
) -> Scene:
    """Build a scene from TOML text, such as the text in a recording.

    Parameters
    ----------
    text
        The text; at most as long as `longest_text` allows. Overrides remove the comments of a long text.
    source
        Name of the text in messages.
    overrides
        As for `load_scene`.
    bodies
        Source of the bodies in [[bodies]] tables; by default files in the current folder.

    Raises
    ------
    SceneError
        The message states the source, the line and the key.
    """
    if len(text) > LARGEST_FILE:
        raise SceneError(f"{source}: {len(text)} characters are too many for a scene; at most {LARGEST_FILE}")
    data = _parse(text, source)
    if not overrides:
        return _validate(data, text, KeyPlaces(source, text, {}), bodies)
    document: Any = tomlkit.parse(text) if len(text) <= _COMMENTED else copy.deepcopy(data)
    overridden = apply_overrides(document, data, overrides)
    effective = tomlkit.dumps(document) if len(text) <= _COMMENTED else _written(document)
    return _validate(_parse(effective, source), effective, KeyPlaces(source, text, overridden), bodies)


def longest_text(bodies: int) -> int:
    """Return the largest number of characters of a scene. Longer scenes are refused, so that recordings can be read."""
    return min(LARGEST_FILE, _LARGEST_BESIDES_BODIES + _LARGEST_BODY * bodies)


def _parse(text: str, source: str) -> dict[str, Any]:
    """Read TOML of up to `DEEPEST` levels."""
    line = line_of_long_key(text)
    if line is not None:
        raise SceneError(f"{source}:{line}: a key of more than {DEEPEST} parts")
    try:
        data = tomllib.loads(text)
    except ValueError as error:  # not only TOMLDecodeError, since Python refuses numbers of thousands of digits
        digits = re.search(r"\d{4301}", text) if "digits" in str(error) else None
        if digits:
            line = text.count("\n", 0, digits.start()) + 1
            raise SceneError(f"{source}:{line}: not TOML: a whole number of more than 4300 digits") from None
        at = re.search(r"\(at line (\d+), column (\d+)\)$", str(error))
        place = f"{source}:{at[1]}" if at else source
        before = after = ""  # the line up to the mistake, and the line from there on
        if at:
            line_of_mistake, column = text.split("\n")[int(at[1]) - 1], int(at[2]) - 1
            before, after = line_of_mistake[:column], line_of_mistake[column:]
        meant = meant_by(str(error), before, after)
        raise SceneError(f"{place}: not TOML: {error}{f'; {meant}' if meant else ''}") from None
    except RecursionError:
        raise SceneError(f"{source}: {_TOO_DEEP}") from None
    if is_too_deep(data):
        raise SceneError(f"{source}: {_TOO_DEEP}")
    return data


def scene_from_dict(data: dict[str, Any], bodies: BodySource | None = None) -> Scene:
    """Build a scene from a plain dictionary; errors name the key. For ``bodies``, see `scene_from_text`."""
    if is_too_deep(data):
        raise SceneError(f"not a scene: {_TOO_DEEP}")
    try:
        try:
            text = toml_text(data)
        except TypeError:
            data = _without_arrays(data)
            text = _written(data)
    except UnicodeEncodeError as error:
        half = error.object[error.start]
        raise SceneError(f"a text has {half!a}, which is half of a character: no file can hold it") from None
    return _validate(data, text, KeyPlaces("", "", {}), bodies)


def _without_arrays(value: Any) -> Any:
    """Convert NumPy's arrays and numbers in a value to lists and numbers."""
    if isinstance(value, dict):
        return {key: _without_arrays(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [_without_arrays(inner) for inner in value]
    return value.tolist() if isinstance(value, np.ndarray | np.generic) else value


def _written(data: dict[str, Any]) -> str:
    try:
        return toml_text(data)
    except TypeError as error:
        raise SceneError(f"not a scene: {error}") from None


def _validate(data: dict[str, Any], text: str, places: KeyPlaces, bodies: BodySource | None) -> Scene:
    know_installed_parts()
    data, text = _with_contents(data, text, places, _folder_of(bodies))
    numbers, units, wrong = converted(data)
    more = max(0, len(wrong) - _MOST_DETAILS)
    messages: dict[KeyPath, Callable[[], str]] = {
        each.path: partial(not_a_quantity, each, places) for each in wrong[:_MOST_DETAILS]
    }
    try:
        scene = Scene.model_validate(numbers)
    except ValidationError as error:
        details = error.errors(include_url=False)
        more += max(0, len(details) - _MOST_DETAILS)
        for detail in with_words(details[:_MOST_DETAILS]):
            path = written_path(detail, data)
            if not is_known(path, messages):
                messages[path] = partial(explain, detail, path, places, data, units)
    _refuse(list(messages.values()), more)
    if scene.bodies:
        scene, text = _with_bodies(scene, units, data, text, places, bodies or DataFiles(Path()))
    if len(text) > longest_text(scene.count):
        raise SceneError(
            f"{places.file or 'the scene'}: {len(text)} characters are too many for a scene of {scene.count} bodies; "
            f"at most {longest_text(scene.count)}"
        )
    scene._toml, scene._unit_system, scene._places = text, units, places
    return scene


def _folder_of(source: BodySource | None) -> Path | None:
    """Return the folder to which names of files are relative; None for the scene of a recording, without files."""
    if source is not None and not isinstance(source, DataFiles | HeldBodies):
        return None
    files = source.files if isinstance(source, HeldBodies) else source
    return files.folder if files is not None else Path()


def _with_contents(
    data: dict[str, Any], text: str, places: KeyPlaces, folder: Path | None
) -> tuple[dict[str, Any], str]:
    """Read the files of walls; return the scene's keys and its text with the contents of the files."""
    found, wrong = dict[tuple[int, str], str](), list[Callable[[], str]]()
    walls = data.get("wall")
    for index, wall in enumerate(walls if isinstance(walls, list) else ()):
        for name in KNOWN_SHAPES if isinstance(wall, dict) else ():
            section, read = wall.get(name), shape_called(name).read if name in wall else None
            if read is None or not isinstance(section, dict) or section.get(CONTENT):
                continue
            if folder is not None and isinstance(file := section.get("file"), str) and file:
                try:
                    found[index, name] = read(folder / file, file)
                except SceneError as error:
                    key = f"wall.{index}.{name}.file"
                    wrong.append(partial(str, f"{places.of(('wall', index, name, 'file'))}{key}: {error}"))
    _refuse(wrong)
    if not found:
        return data, text
    document: Any = tomlkit.parse(text) if len(text) <= _COMMENTED else copy.deepcopy(data)
    data = copy.deepcopy(data)
    for (index, name), content in found.items():
        for one in (document, data):
            one["wall"][index][name][CONTENT] = content
    return data, tomlkit.dumps(document) if len(text) <= _COMMENTED else _written(data)


def _refuse(messages: Sequence[Callable[[], str]], more: int = 0) -> None:
    """Refuse a scene, with a line for each of the first mistakes; ``more`` is the number of other mistakes."""
    more += len(messages) - MOST_MESSAGES
    if messages:
        shown = [message() for message in messages[:MOST_MESSAGES]]
        raise SceneError("\n".join([*shown, f"… and {more} more"] if more > 0 else shown))


def _centre_of(scene: Scene, section: BodyData) -> Centre | None:
    """Return the central body of the orbits in a [[bodies]] table; None if the table has no orbits."""
    orbit, constant = section.orbit, scene.gravity.constant
    if orbit is None:
        return None
    if orbit.central_mass is not None:
        return Centre(constant, orbit.central_mass)
    named = [body for body in scene.body if body.name == orbit.central_body]
    if len(named) != 1:
        known = suggestion(str(orbit.central_body), [body.name for body in scene.body if body.name])
        raise SceneError(f'{section.called}: {len(named)} [[body]] are called "{orbit.central_body}"; {known}')
    body = made_of(scene, named[0])
    return Centre(constant, body_mass(body), body.name, body.position, body.velocity)


def _with_bodies(
    scene: Scene, units: UnitSystem, data: dict[str, Any], text: str, places: KeyPlaces, source: BodySource
) -> tuple[Scene, str]:
    """Find the bodies of each [[bodies]] table; return the scene, and its text with their counts and digests."""
    sources, row, wrong = list[SourcedBodies](), 0, list[Callable[[], str]]()
    for index, section in enumerate(scene.bodies):
        try:
            material = material_called(scene, section.material) if section.material else None
            centre = _centre_of(scene, section)
            sources.append(source.find(Wanted(section, index, len(scene.body) + row, row, units, material, centre)))
            row += len(sources[-1].columns)
        except SceneError as error:
            wrong.append(partial(str, f"{places.of(('bodies', index, 'file'))}bodies.{index}: {error}"))
            row += section.count or 0
    _refuse(wrong)
    taken, refuted = take_over_laws(scene, units, data.get("gravity", {}), sources)
    refuted |= compare_facts(scene, units, sources)
    _refuse(
        [
            partial(str, f"{places.of(('bodies', index, 'file'))}bodies.{index}: {scene.bodies[index].called}: {why}")
            for index, why in refuted.items()
        ]
    )
    known = [{"count": len(one.columns), "sha256": one.sha256} for one in sources]
    sections = tuple(section.model_copy(update=values) for section, values in zip(scene.bodies, known, strict=True))
    if sections != scene.bodies or taken:
        document: Any = tomlkit.parse(text) if len(text) <= _COMMENTED else copy.deepcopy(data)
        for index, values in enumerate(known):
            document["bodies"][index].update(values)
        for key, number in taken.items():
            apply_override(document, f"gravity.{key}={number!r}")
        text = tomlkit.dumps(document) if len(text) <= _COMMENTED else _written(document)
        numbers = {key: units.converted(number, LAW[key]) for key, number in taken.items()}
        gravity = scene.gravity.model_copy(update=numbers)
        scene = scene.model_copy(update={"bodies": sections, "gravity": gravity})
    files = source.files if isinstance(source, HeldBodies) else source if isinstance(source, DataFiles) else None
    scene._held = HeldBodies(sections, tuple(sources), units, files)
    return scene, text


def scene_from_arrays(
    arrays: Mapping[str, ArrayLike | None],
    name: str | ArrayLike | None,
    made_of: str | None,
    sections: Mapping[str, Any],
) -> Scene:
    """Build a scene, as described in `Scene.from_arrays`."""
    if "bodies" in sections:
        raise SceneError("bodies: their source is the arrays; give only the other sections, or use with_bodies")
    return _scene(sections, [], [], arrays, name, made_of)


def scene_with_arrays(scene: Scene, keep: bool, arrays: Mapping[str, Any]) -> Scene:
    """Return a scene with other bodies; see `Scene.with_bodies`."""
    wanted = dict(arrays)
    name, made_of = wanted.pop("name", None), wanted.pop("made_of", None)
    data = tomllib.loads(scene.toml)
    others = {key: value for key, value in data.items() if keep or key not in ("body", "group")}
    held = scene.held if keep else None
    sections, kept = ([], []) if held is None else (list(held.sections), list(held.bodies))
    return _scene(others, sections, kept, wanted, name, made_of)


def _scene(
    data: Mapping[str, Any],
    sections: list[BodyData],
    held_bodies: list[SourcedBodies],
    arrays: Mapping[str, Any],
    name: str | ArrayLike | None,
    made_of: str | None,
) -> Scene:
    """Build a scene from sections, kept bodies, and bodies in arrays."""
    units = unit_system(data.get("units"), [])  # mistakes in units are reported when the scene is validated
    numbers, _, _ = converted({key: data[key] for key in ("units", "material") if key in data})
    material: Material | None
    try:
        material = next((Material.model_validate(row) for row in numbers["material"] if row["name"] == made_of), None)
    except (KeyError, TypeError, ValueError):  # mistakes in materials are reported then, too
        material = None
    columns = columns_of_arrays(arrays, name, material, units)
    prefix = {"name": name} if isinstance(name, str) else {}
    own = {} if made_of is None else {"material": made_of}
    section = {**prefix, **own, "count": len(columns), "sha256": columns.sha256}
    kept = data.get("bodies", [])[: len(sections)]
    held = HeldBodies(
        (*sections, BodyData.model_validate(section)),
        (*held_bodies, SourcedBodies(columns, columns.sha256, material)),
        units,
    )
    return scene_from_dict({**data, "bodies": [*kept, section]}, held)
