"""Scene files: the bundled scenes, paths by name, the text of a file or a pipe, and scenes as TOML text.

`KeyPlaces` are the places of keys in the text, for messages. No known TOML library keeps the line of a key, so
`lines_of` scans the text again, line by line. For keys in unusual forms, such as multi-line inline tables, `lines_of`
returns the line of their section.
"""

from __future__ import annotations

import difflib
import json
import os
import re
import stat
import time
import tomllib
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import tomlkit
import tomlkit.exceptions

from carom.errors import SceneError
from carom.scene.wording import command, escaped

PACKAGE = Path(__file__).parents[1]
CROSSCHECK = "crosscheck"  # the folder of scenes from bug reports of other engines
EXTREMES = "extremes"  # the folder of scenes with numerical extremes, and the prefix of their names
_BARE_KEY = re.compile(r"[A-Za-z0-9_-]+")


def bundled_scenes() -> dict[str, Path]:
    """Return the path of each bundled scene by its name, in order of the names."""
    return _scenes()


def extreme_scenes() -> dict[str, Path]:
    """Return the path of each numerical extreme by its name, such as ``extremes/mass-ratio``, in order of the names."""
    return _scenes(EXTREMES)


def crosscheck_scenes() -> dict[str, Path]:
    """Return the path of each scene from another engine's bug report, such as ``crosscheck/jolt-higher-bounce``."""
    return _scenes(CROSSCHECK)


def bundled_folders() -> dict[str, list[str]]:
    """Return the names of the bundled scenes by folder."""
    return {EXTREMES: list(extreme_scenes()), CROSSCHECK: list(crosscheck_scenes())}


def _scenes(folder: str = "") -> dict[str, Path]:
    installed = PACKAGE / "configs"
    configs = installed if installed.is_dir() else PACKAGE.parents[1] / "configs"
    paths = sorted((configs / folder).glob("*.toml"), key=lambda path: path.stem)
    return {path.relative_to(configs).with_suffix("").as_posix(): path for path in paths}


def data_files(scene: Path) -> list[Path]:
    """Return the data files that accompany a bundled scene."""
    sections = tomllib.loads(scene.read_text(encoding="utf-8")).get("bodies", [])
    return [scene.with_name(section["file"]) for section in sections]


def starter() -> str:
    """Return the text of the commented scene that `carom new` writes."""
    return (Path(__file__).parent / "starter.toml").read_text(encoding="utf-8")


LARGEST_FILE = 64_000_000  # bytes; enough for 400 000 [[body]] sections, which take half a minute to read
PATIENCE = 30.0  # s, longest silence of a pipe
RECORDED = b"RRF2"  # first bytes of a recording

_PIECE = 1 << 20  # bytes read at a time
_PAUSE = 0.01  # s between two attempts to read a silent pipe


def scene_path(source: str | Path) -> Path:
    """Return the path of a scene's file, or of the bundled scene with the given name."""
    path = Path(source)
    try:
        if path.is_dir():
            raise SceneError(f"{path}: a folder, not a scene; name a .toml file in it")
        if path.exists():
            return path
    except OSError as error:  # for example a name of 300 characters
        raise SceneError(f"{str(source)[:100]}: cannot be read: {error.strerror}") from None
    bundled = bundled_scenes() | extreme_scenes() | crosscheck_scenes()
    if str(source) in bundled:
        return bundled[str(source)]
    beside = path.with_name(f"{path.name}.toml")
    if beside.is_file():
        raise SceneError(f"{source}: no such file; did you mean {beside}?")
    near = difflib.get_close_matches(str(source), bundled, n=1) or difflib.get_close_matches(path.stem, bundled, n=1)
    meant = f'; did you mean the bundled scene "{near[0]}"?' if near else ""
    raise SceneError(f"{source}: no such file, and no bundled scene of that name{meant} (`carom scenes` lists them)")


def read_text(path: Path) -> str:
    """Read the text of a scene from a file or a pipe; refuse a recording, a device and a text that is too long."""
    try:
        text = _read_bytes(path)
    except OSError as error:
        raise SceneError(f"{path}: cannot be read: {error.strerror}") from None
    if text.startswith(RECORDED):
        uses = {"view": "shows it", "inspect": "says how it went", "replay": "runs it again", "resume": "continues it"}
        listed = ", ".join(f"`{command(name, path)}` {use}" for name, use in uses.items())
        raise SceneError(f"{path}: a recording, not a scene; {listed}")
    try:
        return text.decode("utf-8-sig")  # some editors write a byte order mark at the beginning of a file
    except UnicodeDecodeError as error:
        raise SceneError(f"{path}: not TOML: not UTF-8 text (byte {error.start})") from None


def _read_bytes(path: Path) -> bytes:
    """Read a regular file or a pipe once, up to `LARGEST_FILE` bytes."""
    # without this flag, a pipe without a writer would block
    descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    with os.fdopen(descriptor, "rb", buffering=0) as file:
        kind = os.fstat(descriptor)
        is_pipe = stat.S_ISFIFO(kind.st_mode) or stat.S_ISSOCK(kind.st_mode)
        if not is_pipe and not stat.S_ISREG(kind.st_mode):
            raise SceneError(f"{path}: a device, not a scene; name a .toml file")
        if kind.st_size > LARGEST_FILE:
            raise SceneError(f"{path}: {kind.st_size} bytes are too many for a scene; at most {LARGEST_FILE}")
        text, begun = bytearray(), time.monotonic()
        while True:
            piece = file.read(_PIECE)  # None means nothing to read yet
            if piece:
                text += piece
                begun = time.monotonic()
                if len(text) > LARGEST_FILE:
                    raise SceneError(f"{path}: more than {LARGEST_FILE} bytes, which are too many for a scene")
            elif piece is not None and (text or not is_pipe):
                return bytes(text)
            elif time.monotonic() - begun > PATIENCE:
                raise SceneError(f"{path}: nothing has written to this pipe for {PATIENCE:g} s; name a .toml file")
            else:
                time.sleep(_PAUSE)


def toml_text(data: Mapping[str, Any]) -> str:
    """Write a document: plain keys first, then a section for each table and for each table in a list.

    Reading takes ten microseconds per body; tomlkit, which keeps comments, takes a millisecond.

    Raises
    ------
    TypeError
        If a value has a type that scenes do not have.
    UnicodeEncodeError
        If a text has half of a character (a lone surrogate).
    """

    def is_section(value: Any) -> bool:
        is_list = isinstance(value, list | tuple) and len(value) > 0
        return isinstance(value, Mapping) or (is_list and all(isinstance(item, Mapping) for item in value))

    lines = [f"{_key(key)} = {value_text(value)}" for key, value in data.items() if not is_section(value)]
    for key, value in data.items():
        if is_section(value):
            header = f"[{_key(key)}]" if isinstance(value, Mapping) else f"[[{_key(key)}]]"
            for table in [value] if isinstance(value, Mapping) else value:
                lines += ["", header, *(f"{_key(name)} = {value_text(inner)}" for name, inner in table.items())]
    return "\n".join(lines) + "\n"


def _key(key: Any) -> str:
    if not isinstance(key, str):
        raise TypeError(f"{key!r}: a key must be text")
    return key if _BARE_KEY.fullmatch(key) else _string(key)


def value_text(value: Any) -> str:
    """Write one value; raises TypeError like `toml_text`."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return _string(value)
    if isinstance(value, int):
        return int.__repr__(value)
    if isinstance(value, float):
        return float.__repr__(value)  # true for subclasses of float, too, such as NumPy's
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{_key(key)} = {value_text(inner)}" for key, inner in value.items()) + "}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(value_text, value)) + "]"
    raise TypeError(f"a scene has no values of type {type(value).__name__}")


def _string(text: str) -> str:
    """Quote text: TOML escapes the same characters as JSON, and DEL; unescaped, they would steer a terminal."""
    text.encode()  # raises if the text has a lone surrogate
    return escaped(json.dumps(text, ensure_ascii=False))


# numbers in a form that people write, but that TOML lacks
_NUMBER = re.compile(r"[+-]?(\.[0-9]+|[0-9]+\.)([eE][+-]?[0-9]+)?")


def parse_value(text: str) -> Any:
    """Read a TOML value; a bare word is a string."""
    try:
        return tomlkit.value(text).unwrap()
    except (tomlkit.exceptions.TOMLKitError, ValueError):
        return float(text) if _NUMBER.fullmatch(text) else text


KeyPath = tuple[str | int, ...]

_HEADER = re.compile(r"^\s*(\[\[?)\s*([^\[\]]+?)\s*\]\]?\s*(#.*)?$")
_KEY = re.compile(r"""^\s*((?:[\w-]+|"[^"]*"|'[^']*')(?:\s*\.\s*(?:[\w-]+|"[^"]*"|'[^']*'))*)\s*=""")


def lines_of(text: str) -> dict[KeyPath, int]:
    """Return the line (from 1) of the first occurrence of each key and each section."""
    lines: dict[KeyPath, int] = {}
    section: KeyPath = ()
    seen: Counter[KeyPath] = Counter()
    for number, line in enumerate(text.splitlines(), start=1):
        header, key = _HEADER.match(line), _KEY.match(line)
        if header:
            *above, last = _split(header[2])
            section = (*_indexed(above, seen), last)
            if header[1] == "[[":
                seen[section] += 1
                lines.setdefault(section, number)  # a section that is written as a list of sections
            section = written = _indexed([*above, last], seen)
        elif key:
            written = (*section, *_split(key[1]))
        else:
            continue
        lines.setdefault(written, number)
    return lines


def _indexed(keys: Iterable[str | int], seen: Counter[KeyPath]) -> KeyPath:
    """Insert the index of the latest section after each key of a list of sections, such as ``[[group]]``."""
    path: KeyPath = ()
    for key in keys:
        path = (*path, key)
        if seen[path]:
            path = (*path, seen[path] - 1)
    return path


def _split(dotted: str) -> KeyPath:
    return tuple(part.strip().strip("\"'") for part in dotted.split("."))


@dataclass(eq=False)
class KeyPlaces:
    """The place of each key: a line of a file, or an override."""

    file: str
    text: str
    overrides: dict[KeyPath, str]

    def __eq__(self, other: object) -> bool:
        """Compare equal to any other `KeyPlaces`: places do not affect the equality of scenes."""
        return isinstance(other, KeyPlaces)

    __hash__ = None  # type: ignore[assignment]

    @cached_property
    def _lines(self) -> dict[KeyPath, int]:
        return lines_of(self.text)

    def of(self, path: KeyPath) -> str:
        """Return the place of a key, as the first words of a message; empty if unknown."""
        for overridden, text in self.overrides.items():
            if path[: len(overridden)] == overridden:
                return f"the override {text}: "
        line = next((self._lines[path[:n]] for n in range(len(path), 0, -1) if path[:n] in self._lines), None)
        if not line:  # a section created by an override
            for overridden, text in self.overrides.items():
                if path and overridden[: len(path)] == path:
                    return f"the override {text}: "
        if not self.file:
            return ""
        return f"{self.file}:{line}: " if line else f"{self.file}: "


# Limit on the nesting: parsing, validation and messages are recursive, or take time quadratic in the depth.
DEEPEST = 32  # deepest level; the deepest key of a scene is group.0.radius.min

_PART = r"""(?:[\w-]++|"(?:[^"\\\n]|\\.)*+"|'[^'\n]*+')"""
_LONG_KEY = re.compile(rf"(?:^[ \t]*+\[{{0,2}}|[{{,])[ \t]*+(?:{_PART}[ \t]*+\.[ \t]*+){{{DEEPEST}}}", re.MULTILINE)


def line_of_long_key(text: str) -> int | None:
    """Return the line (from 1) of a dotted key with more than `DEEPEST` parts; None if there is none."""
    long_key = _LONG_KEY.search(text)
    return text.count("\n", 0, long_key.start()) + 1 if long_key else None


def is_too_deep(data: Any) -> bool:
    """Return whether tables and lists are nested more than `DEEPEST` levels deep, or contain themselves."""
    level = [data]
    for _ in range(DEEPEST + 1):
        inner = (child for node in level for child in (node.values() if isinstance(node, dict) else node))
        level = list({id(child): child for child in inner if isinstance(child, (dict, list, tuple))}.values())
        if not level:
            return False
    return True
