"""The plan of a sweep: the scene, the varied values, and a name for every run."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import tomlkit

from carom.errors import ExperimentError, SceneError
from carom.scene import variation
from carom.scene.data.body_sources import HeldBodies
from carom.scene.load import Scene, scene_from_text

SEED = "seed"
_LONGEST_NAME = 120  # limit on the characters of a run's name; attempts have longer names, and a file name may have 255
_FILE = re.compile(r"bodies\.\d+\.file")
_UNSAFE = re.compile(r"[^A-Za-z0-9._+-]+")


@dataclass(frozen=True, slots=True)
class SweepPoint:
    """A planned run."""

    name: str  # made from the varied values; the recording has the same name
    parameters: dict[str, Any]  # varied values by key, without the seed
    seed: int

    @property
    def overrides(self) -> list[str]:
        """The changes to the scene, in the form of ``--set``."""
        return [variation.override(key, value) for key, value in {**self.parameters, SEED: self.seed}.items()]


@dataclass(frozen=True, slots=True)
class Plan:
    """All runs of a sweep."""

    title: str
    scene: str  # TOML, without [sweep]
    varied: tuple[str, ...]  # varied keys in the order in which they occur in names; the seed is last if it varies
    points: tuple[SweepPoint, ...]
    files: Mapping[str, Path] = field(default_factory=dict)  # data files of the scene, by their names in the scene
    units: str = "SI"  # units of the results, as `UnitSystem.recorded` names them

    @property
    def digest(self) -> str:
        """The digest of the scene."""
        return digest(self.scene)


def digest(scene: str) -> str:
    """Return the digest of the text of a scene."""
    return hashlib.sha256(scene.encode()).hexdigest()


def plan(
    source: str | Path,
    overrides: Sequence[str] = (),
    vary: Sequence[str] = (),
    seeds: int | None = None,
    zipped: bool | None = None,
) -> Plan:
    """Plan a sweep of a scene, whose ``[sweep]`` section has the defaults of the other parameters.

    Raises SceneError or ExperimentError if the scene cannot be loaded, or no run of the sweep can be made.

    Parameters
    ----------
    overrides
        ``key=value``, for all runs.
    vary
        ``key=values`` as `carom.scene.variation.values_of` reads them; they replace the same key of ``[sweep]``.
    seeds
        Number of runs of each combination, with consecutive seeds from the seed of the scene.
    zipped
        Whether the values of all keys are paired one by one. Each pair is always combined with all seeds.
    """
    scene = Scene.load(source, list(overrides))
    axes = {**scene.sweep.vary, **dict(_axis(text) for text in vary)}
    count = seeds if seeds is not None else scene.sweep.seeds
    if not axes and count is None:
        raise ExperimentError(
            "nothing varies; give --vary key=a,b,c or --seeds N, or add a [sweep] section to the scene"
        )
    if SEED in axes and count is not None:
        raise ExperimentError(
            "seeds are given twice, as a number of seeds and as values of seed; remove one of the two"
        )
    try:
        rows = variation.combinations(axes, scene.sweep.zip if zipped is None else zipped)
    except ValueError as error:
        raise ExperimentError(f"--vary: {error}") from None
    if len(rows) * (count or 1) > variation.MOST_RUNS:
        raise ExperimentError(f"{variation.TOO_MANY_RUNS}, or fewer seeds")
    numbers = range(scene.seed, scene.seed + (count or 1))
    rows = [{**row, SEED: seed} for row in rows for seed in ([row[SEED]] if SEED in row else numbers)]
    varied = (*(key for key in axes if key != SEED), *((SEED,) if count is not None or SEED in axes else ()))
    document = tomlkit.parse(scene.toml)
    document.pop("sweep", None)  # a run must not depend on the other runs
    text = tomlkit.dumps(document).rstrip() + "\n"
    last = [key.rsplit(".", 1)[-1] for key in varied]
    short = {key: name if last.count(name) == 1 else key for key, name in zip(varied, last, strict=True)}
    points = tuple(_point(row, short) for row in rows)
    _refuse_hopeless(text, points, scene.held)
    # the data files of all runs within the scene's folder, by their names in the scene
    named = [section.file for section in scene.bodies]
    named += [value for point in points for key, value in point.parameters.items() if _FILE.fullmatch(key)]
    files, found = None if scene.held is None else scene.held.files, {}
    for name in named:
        if files is not None and isinstance(name, str) and not Path(name).is_absolute():
            if ".." in Path(name).parts:
                raise ExperimentError(
                    f"{name}: a sweep copies data files, so put it into the folder of the scene or a subfolder"
                )
            found[name] = files.folder / name
    return Plan(scene.title, text, varied, points, found, scene.unit_system.recorded)


def _axis(text: str) -> tuple[str, variation.Values]:
    key, separator, values = text.partition("=")
    if not separator or not key.strip():
        raise ExperimentError(f"--vary {text}: expected key=values, such as contact.restitution=0.1:0.9:5")
    try:
        return key.strip(), variation.values_of(values)
    except ValueError as error:
        raise ExperimentError(f"--vary {key.strip()}: {error}") from None


def _point(row: dict[str, Any], short: dict[str, str]) -> SweepPoint:
    """Name a run by its values; ``short`` has the abbreviations of the keys."""
    shown = [(short[key], _shown(row[key])) for key in short]
    name = ",".join(f"{key}={value}" for key, value in shown)
    safe = ",".join(f"{_UNSAFE.sub('_', key)}={_UNSAFE.sub('_', value)}" for key, value in shown)
    if safe != name or len(safe) > _LONGEST_NAME:  # shortened names might coincide
        safe = f"{safe[:_LONGEST_NAME]}-{hashlib.sha256(name.encode()).hexdigest()[:8]}"
    parameters = {key: value for key, value in row.items() if key != SEED}
    return SweepPoint(safe, parameters, row[SEED])


def _shown(value: Any) -> str:
    if isinstance(value, str):
        return value
    if isinstance(value, list) and all(isinstance(part, (int, float)) for part in value):
        return "_".join(map(str, value))
    return json.dumps(value)


def _refuse_hopeless(text: str, points: Sequence[SweepPoint], held: HeldBodies | None) -> None:
    """Refuse a sweep without a valid run, so that a misspelt key is reported once, not for each run."""
    errors = []
    for point in points:
        try:
            scene_from_text(text, "scene.toml", point.overrides, held)
            return
        except SceneError as error:
            errors.append(error)
    raise errors[0]
