"""A scene's file: where it is, and what its text is."""

from __future__ import annotations

import difflib
from pathlib import Path

from carom.scene.bundled import bundled_scenes, crosscheck_scenes, extreme_scenes
from carom.scene.command import command
from carom.scene.error import SceneError

LARGEST_FILE = 64_000_000  # bytes; enough for 400 000 [[body]] sections, which take half a minute to read
RECORDED = b"RRF2"  # first bytes of a recording


def scene_path(source: str | Path) -> Path:
    """Return the path of a scene's file, or of a bundled scene of that name."""
    try:
        return _found(source)
    except OSError as error:  # a name of 300 characters
        raise SceneError(f"{str(source)[:100]}: cannot be read: {error.strerror}") from None


def _found(source: str | Path) -> Path:
    path = Path(source)
    if path.is_dir():
        raise SceneError(f"{path}: a folder, not a scene; give a .toml file in it")
    if path.exists():
        return path
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
    """Read a scene's file; refuse a recording and what is too long."""
    try:
        with path.open("rb") as file:
            if file.read(4) == RECORDED:
                raise SceneError(f"{path}: a recording, not a scene; {_what_to_do_with(path)}")
        if path.stat().st_size > LARGEST_FILE:
            raise SceneError(f"{path}: {path.stat().st_size} bytes are too many for a scene; at most {LARGEST_FILE}")
        return path.read_text(encoding="utf-8-sig")  # some editors begin a file with a byte order mark
    except UnicodeDecodeError as error:
        raise SceneError(f"{path}: not TOML: not UTF-8 text (byte {error.start})") from None
    except OSError as error:
        raise SceneError(f"{path}: cannot be read: {error.strerror}") from None


def _what_to_do_with(recording: Path) -> str:
    done = {"view": "shows it", "inspect": "says how it went", "replay": "runs it again", "resume": "continues it"}
    return ", ".join(f"`{command(name, recording)}` {what}" for name, what in done.items())
