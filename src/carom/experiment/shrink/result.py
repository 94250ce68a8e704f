"""The file of a reduced scene: what is written above it, and how an unfinished one is found again."""

from __future__ import annotations

import hashlib
import re
from pathlib import Path

from carom.experiment.environment import versions
from carom.experiment.shrink.literal import Document
from carom.experiment.shrink.reducer import Reduction, Stage
from carom.experiment.shrink.text import commented
from carom.recording.errors import RecordingError

_MARK = re.compile(r"^# shrink ([0-9a-f]{12}), (unfinished|minimal)$", re.MULTILINE)
_HEAD = 10_000  # characters, in which the mark stands


def key_of(scene_toml: str, condition: str) -> str:
    """Return 48 bits that name a scene and a condition."""
    return hashlib.sha256(f"{scene_toml}\0{condition}".encode()).hexdigest()[:12]


def state_of(path: Path, key: str) -> str:
    """Return ``unfinished`` or ``minimal`` if a file is the result for a key; empty otherwise."""
    try:
        with path.open(encoding="utf-8") as file:
            found = _MARK.search(file.read(_HEAD))
    except (OSError, UnicodeDecodeError):
        return ""
    return found[2] if found and found[1] == key else ""


def text_of(document: Document, asked: str, reduction: Reduction | None, said: str, key: str, command: str) -> str:
    """Write a reduced scene with its comments; without a reduction, one that is still going on."""
    finished = reduction is not None and reduction.minimal
    comments = [command, f"Asked for: {asked}", f"Shown here: {said}"]
    if reduction is not None:
        comments += _history(reduction)
    if not finished:
        why = reduction.stopped if reduction else "still at work"
        comments.append(f"Not finished ({why}): the same command goes on from here.")
    return commented(document, [*comments, f"shrink {key}, {'minimal' if finished else 'unfinished'}"])


def _history(reduction: Reduction) -> list[str]:
    bodies, steps = reduction.before
    end = "Leaving out any body, key or digit makes it go away." if reduction.minimal else ""
    left = f"Left: {_counted(reduction.bodies, 'body')} of {bodies}, {_counted(reduction.steps, 'step')} of {steps}."
    found = "; ".join(_told(stage) for stage in reduction.stages)
    how = f"Found by carom {versions()['carom']} with {reduction.candidates} candidates in {reduction.seconds:.3g} s"
    return [f"{left} {end}".strip(), f"{how}: {found}."]


def _told(stage: Stage) -> str:
    return f"{stage.name}, {_counted(stage.bodies, 'body')}, {_counted(stage.steps, 'step')}"


def _counted(count: int, noun: str) -> str:
    plural = {"body": "bodies"}.get(noun, f"{noun}s")
    return f"{count} {noun if count == 1 else plural}"


def write(path: Path, text: str) -> None:
    """Replace a file at once, so that an interrupt leaves a whole one.

    Raises
    ------
    RecordingError
        If it cannot be written.
    """
    part = path.with_name(f"{path.name}.part")
    try:
        part.write_text(text, encoding="utf-8")
        part.replace(path)
    except OSError as error:
        part.unlink(missing_ok=True)
        raise RecordingError(f"cannot write {path}: {error.strerror}") from None
