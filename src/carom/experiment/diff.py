"""Where and how two recordings part: scene, versions, first frame, growth."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from carom.experiment.growth import Curve, Growth, Verdict, growth, verdict
from carom.experiment.matched import Matched
from carom.recording.errors import RecordingError
from carom.recording.overlay import Pair, write_overlay
from carom.recording.recording import Recording


@dataclass(frozen=True, slots=True)
class Diff:
    """Two recordings compared."""

    paths: tuple[Path, Path]
    scene: dict[str, tuple[Any, Any]]  # keys that differ
    environment: dict[str, tuple[Any, Any]]  # what differs of versions, machine, command
    frames: tuple[int, int]
    matched_by: str  # "step", or "sim_time" where dt differs
    curve: Curve
    growth: Growth | None
    verdict: Verdict

    @property
    def same(self) -> bool:
        """Whether all frames that both have are the same bits."""
        return self.verdict.kind == "same"


def diff(a: Recording, b: Recording) -> Diff:
    """Compare two recordings.

    Frames are matched by step if both have the same times, else by time; then positions and energies of the second are
    interpolated linearly between its frames.

    Raises
    ------
    RecordingError
        If they have no frame in common, do not show the same bodies, or cannot be read.
    """
    matched = Matched(a, b)
    curve = matched.curve()
    grown = growth(curve)
    return Diff(
        paths=(a.path, b.path),
        scene=differing(_scene(a), _scene(b)),
        environment=differing(a.properties, b.properties),
        frames=(a.frames, b.frames),
        matched_by=matched.by,
        curve=curve,
        growth=grown,
        verdict=verdict(curve, grown),
    )


def overlay(a: Recording, b: Recording, found: Diff, out: Path) -> None:
    """Write both into one recording, to look at. RecordingError if it cannot be written."""
    matched = Matched(a, b)
    text = f"{found.verdict.text[0].upper()}{found.verdict.text[1:]}."
    curve = found.curve
    pairs = (Pair(int(curve.step[k]), float(curve.time[k]), *matched.at(k)[:2]) for k in range(len(curve.step)))
    seen = np.where(curve.rms > curve.floor, curve.rms, np.nan)
    series = {"rms": seen, "energy": np.abs(curve.energy)}
    write_overlay(out, a, b, pairs, len(matched), series, text)


def differing(a: Mapping[str, Any], b: Mapping[str, Any]) -> dict[str, tuple[Any, Any]]:
    """Return the keys whose values differ, with both; None stands for one that is not there."""
    keys = [*a, *(key for key in b if key not in a)]
    return {key: (a.get(key), b.get(key)) for key in keys if a.get(key) != b.get(key)}


def _scene(recording: Recording) -> dict[str, Any]:
    """Read the scene's keys, dotted: ``time.max_dt``, ``body.0.radius``."""
    try:
        return _flat(tomllib.loads(recording.scene_toml))
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        raise RecordingError(f"the scene in {recording.path} cannot be read: {error}") from error


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
