"""The file of a reduced scene: TOML with comments; one comment records whether the reduction is finished."""

from __future__ import annotations

import hashlib
import re
import textwrap
from dataclasses import dataclass
from pathlib import Path

import tomlkit

from carom.errors import RecordingError
from carom.lab.shrink.literal import BODIES, Document
from carom.lab.shrink.reducer import Reduction, Stage
from carom.recording.write.whole_file import write_whole
from carom.runs.environment import versions
from carom.scene.wording import counted, escaped

_MARK = re.compile(
    r"^# shrink ([0-9a-f]{12}) of (\d{1,9}) bodies and (\d{1,9}) steps, (unfinished|minimal)$", re.MULTILINE
)
_HEAD = 10_000  # number of characters at the beginning of a file that are searched for the mark


def key_of(scene_toml: str, condition: str) -> str:
    """Return a digest (48 bits) of a scene and a condition."""
    return hashlib.sha256(f"{scene_toml}\0{condition}".encode()).hexdigest()[:12]


@dataclass(frozen=True, slots=True)
class Earlier:
    """The result of an earlier reduction."""

    finished: bool
    before: tuple[int, int]  # bodies, and steps up to the failure, of the scene before the reduction


def earlier(path: Path, key: str) -> Earlier | None:
    """Return the earlier result in a file; None if the file belongs to another reduction."""
    try:
        with path.open(encoding="utf-8") as file:
            found = _MARK.search(file.read(_HEAD))
    except (OSError, UnicodeDecodeError):
        return None
    if found is None or found[1] != key:
        return None
    return Earlier(found[4] == "minimal", (int(found[2]), int(found[3])))


def unfinished_text(
    document: Document, asked: str, said: str, before: tuple[int, int], key: str, command: str, why: str = ""
) -> str:
    """Return the text of the smallest scene so far, from which the same command continues."""
    comments = [command, f"Asked for: {asked}", f"Shown here: {said}"]
    comments.append(f"Not finished ({why or 'still at work'}): the same command continues from here.")
    return commented(document, [*comments, _mark(key, before, "unfinished")])


def text_of(reduction: Reduction, asked: str, key: str, command: str) -> str:
    """Return the text of a reduced scene with its comments."""
    made, before = reduction.document, reduction.before
    if not reduction.minimal:
        return unfinished_text(made, asked, reduction.said, before, key, command, reduction.stopped)
    bodies, steps = before
    taken = f"{counted(reduction.steps, 'step')} of {steps}"
    if reduction.steps > steps:  # the run may have more steps with fewer bodies
        taken = f"{counted(reduction.steps, 'step')}, instead of {steps} in the original scene"
    left = f"Left: {counted(reduction.bodies, 'body')} of {bodies}, {taken}."
    # reported stages: the first stage of each name, and all stages that changed the number of bodies or steps
    told: list[Stage] = []
    for stage in reduction.stages:
        known = any(stage.name == other.name for other in told)
        if not known or (stage.bodies, stage.steps) != (told[-1].bodies, told[-1].steps):
            told.append(stage)
    found = "; ".join(f"{one.name}, {counted(one.bodies, 'body')}, {counted(one.steps, 'step')}" for one in told)
    how = f"Found by carom {versions()['carom']} with {reduction.candidates} candidates in {reduction.seconds:.3g} s"
    comments = [
        command,
        f"Asked for: {asked}",
        f"Failure: {reduction.said}",
        f"{left} Without any one body, key or digit, the failure disappears.",
        f"{how}: {found}.",
        _mark(key, before, "minimal"),
    ]
    return commented(made, comments)


def _mark(key: str, before: tuple[int, int], state: str) -> str:
    return f"shrink {key} of {before[0]} bodies and {before[1]} steps, {state}"


def write(path: Path, text: str) -> None:
    """Replace a file atomically, so that an interrupt leaves a whole file. Raises RecordingError if it fails."""
    try:
        write_whole(path, text)
    except OSError as error:
        raise RecordingError(f"cannot write {path}: {error.strerror}") from None


WIDTH = 110  # largest number of characters in a line of a comment


def commented(document: Document, comments: list[str]) -> str:
    """Return the text of a scene with comments above it, each a paragraph, and one line for each body.

    Control characters in the scene's texts become escapes, as in `toml_text`.
    """
    written = tomlkit.document()
    for paragraph in comments:
        for line in textwrap.wrap(paragraph, WIDTH, break_long_words=False, break_on_hyphens=False):
            written.add(tomlkit.comment(line))
    written.add(tomlkit.nl())
    for key in [key for key, value in document.items() if not isinstance(value, dict | list)]:
        written.add(key, document[key])
    for key in [BODIES, *(key for key, value in document.items() if isinstance(value, list) and key != BODIES)]:
        # a line for each table
        rows = tomlkit.array()
        for values in document[key]:
            row = tomlkit.inline_table()
            row.update(values)
            rows.append(row)
        written.add(key, rows.multiline(True))
    for key, value in document.items():
        if isinstance(value, dict):
            table = tomlkit.table()
            for name, inner in value.items():
                table.add(name, inner)
            written.add(key, table)
    return escaped(tomlkit.dumps(written))
