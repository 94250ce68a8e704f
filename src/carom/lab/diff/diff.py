"""Compares two recordings: scene, versions, first different frame and impact, growth of the difference."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel

from carom.errors import RecordingError, SceneError
from carom.lab.diff.divergence import Curve, Divergence, Verdict, divergence_of, verdict
from carom.lab.diff.frame_alignment import FrameAlignment
from carom.lab.diff.impact_divergence import ImpactDivergence, impact_divergence
from carom.recording.read.recorded_scene import RecordedBodies
from carom.recording.read.recording import Recording
from carom.scene.key_places import DEEPEST, is_too_deep, line_of_long_key
from carom.scene.load import scene_from_text
from carom.scene.schema import Scene
from carom.show.comparison import Pair, write_overlay


@dataclass(frozen=True, slots=True)
class Diff:
    """Two recordings compared."""

    paths: tuple[Path, Path]
    scene: dict[str, tuple[Any, Any]]  # keys that differ; None if one is not written
    defaults: dict[str, Any]  # of the keys that one scene does not write
    environment: dict[str, tuple[Any, Any]]  # differences of versions, machine, command
    frames: tuple[int, int]
    matched_by: str  # "step", or "sim_time" where dt differs
    curve: Curve
    divergence: Divergence | None
    verdict: Verdict
    impacts: ImpactDivergence | None  # None if one has none recorded
    engines: tuple[str, str] = ("", "")  # that the runs were recorded from; empty for carom's own

    @property
    def same(self) -> bool:
        """Whether all common frames are identical to the bit, and so are the impacts of both.

        Against another engine, whose bits are not those of carom, whether no difference is seen.
        """
        return self.verdict.kind == "same" and (self.impacts is None or self.impacts.same)


def diff(a: Recording, b: Recording) -> Diff:
    """Compare two recordings.

    Frames are matched by step if both have the same times, otherwise by time; then positions and energies of the second
    are interpolated linearly between its frames.

    Raises
    ------
    RecordingError
        If they have no frame in common, do not show the same bodies, show several runs, or cannot be read.
    """
    for recording in (a, b):
        recording.refuse_overlay()
    refuse_other_units(a, b)
    matched = FrameAlignment(a, b)
    curve = matched.curve()
    divergence = divergence_of(curve)
    engines, environment = (a.engine, b.engine), differing(a.properties, b.properties)
    written = {} if any(engines) else differing(_scene(a), _scene(b))
    if any(engines):  # of which neither the scene nor how it was run is known
        environment = {key: values for key, values in environment.items() if None not in values and key != "engine"}
    same = _written_otherwise(a, b, written)
    scene = {key: values for key, values in written.items() if key not in same}
    defaults = _defaults(a, b, scene)
    return Diff(
        paths=(a.path, b.path),
        scene={key: values for key, values in scene.items() if key not in defaults or defaults[key] not in values},
        defaults=defaults,
        environment=environment,
        frames=(a.frames, b.frames),
        matched_by=matched.by,
        curve=curve,
        divergence=divergence,
        verdict=verdict(curve, divergence, a.units),
        impacts=impact_divergence(a, b),
        engines=engines,
    )


def refuse_other_units(a: Recording, b: Recording) -> None:
    """Raise RecordingError if the numbers of two recordings are not in the same units."""
    first, second = (recording.units.named if recording.units.own else "SI" for recording in (a, b))
    if first != second:
        raise RecordingError(
            f"{a.path} is in {first or 'no units'} and {b.path} in {second or 'no units'}; they cannot be compared"
        )


def overlay(a: Recording, b: Recording, found: Diff, out: Path) -> None:
    """Write both into one recording for the viewer. Raises RecordingError if it cannot be written."""
    matched = FrameAlignment(a, b)
    text = f"{found.verdict.text[0].upper()}{found.verdict.text[1:]}."
    curve = found.curve
    pairs = (Pair(int(curve.step[k]), float(curve.time[k]), *matched.at(k)[:2]) for k in range(len(curve.step)))
    series = {"rms": np.where(curve.seen, curve.rms, np.nan), "energy": np.abs(curve.energy)}
    write_overlay(out, a, b, pairs, len(matched), series, text)


def differing(a: Mapping[str, Any], b: Mapping[str, Any]) -> dict[str, tuple[Any, Any]]:
    """Return the keys whose values differ, with both values; None for an absent key."""
    keys = [*a, *(key for key in b if key not in a)]
    return {key: (a.get(key), b.get(key)) for key in keys if a.get(key) != b.get(key)}


def _scene(recording: Recording) -> dict[str, Any]:
    """Read the scene's keys, dotted: ``time.max_dt``, ``body.0.radius``."""
    text = recording.scene_toml
    try:
        if line_of_long_key(text) is not None or is_too_deep(document := tomllib.loads(text)):
            raise RecordingError(f"the scene in {recording.path} is nested more than {DEEPEST} levels deep")
        return _flat(document)
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        raise RecordingError(f"the scene in {recording.path} cannot be read: {error}") from error


def _defaults(a: Recording, b: Recording, differing: Mapping[str, tuple[Any, Any]]) -> dict[str, Any]:
    """Return the defaults of one scene for keys that only the other one sets."""
    defaults: dict[str, Any] = {}
    for recording, own in ((a, 0), (b, 1)):
        missing = [key for key, values in differing.items() if values[own] is None]
        if missing:
            scene = _validated(recording)
            defaults |= {key: value for key in missing if (value := _value(scene, key)) is not None}
    return defaults


def _written_otherwise(a: Recording, b: Recording, differing: Mapping[str, tuple[Any, Any]]) -> set[str]:
    """Return the keys with the same value, written with a unit in one scene and without, or another, in the other."""
    both = {key: values for key, values in differing.items() if None not in values}
    with_unit = [key for key, values in both.items() if any(isinstance(value, str) for value in values)]
    if not with_unit:
        return set()
    scenes = _validated(a), _validated(b)
    found = {key: tuple(_value(scene, key) for scene in scenes) for key in with_unit}
    return {key for key, (first, second) in found.items() if first is not None and first == second}


def _validated(recording: Recording) -> Scene | None:
    try:
        return scene_from_text(recording.scene_toml, f"the scene in {recording.path}", bodies=RecordedBodies(recording))
    except SceneError:  # of another version
        return None


def _value(scene: Scene | None, key: str) -> Any:
    """Return the value of a dotted key as in TOML; None if it is absent."""
    node: Any = scene
    for name in key.split("."):
        if isinstance(node, tuple):
            node = node[int(name)] if name.isdigit() and int(name) < len(node) else None
        else:
            node = getattr(node, name, None) if name in getattr(type(node), "model_fields", {}) else None
    if isinstance(node, BaseModel):
        return None
    return list(node) if isinstance(node, tuple) else node


def _flat(document: Any, before: str = "") -> dict[str, Any]:
    items: list[tuple[str, Any]]
    if isinstance(document, dict):
        items = list(document.items())
    elif isinstance(document, list) and document and all(isinstance(value, dict) for value in document):
        items = [(str(k), value) for k, value in enumerate(document)]
    else:
        return {before: document}
    flat: dict[str, Any] = {}
    for key, value in items:
        flat |= _flat(value, f"{before}.{key}" if before else key)
    return flat
