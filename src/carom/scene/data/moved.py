"""The text of a scene that is written into another folder than that of its data files."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

import tomlkit

if TYPE_CHECKING:
    from carom.scene.schema import Scene


def toml_for(scene: Scene, folder: Path) -> str:
    """Return the text of a scene whose data files are named as seen from a folder."""
    files = None if scene.held is None else scene.held.files
    if files is None or files.folder.resolve() == folder.resolve():
        return scene.toml
    document = tomlkit.parse(scene.toml)
    for section, table in zip(scene.bodies, document["bodies"], strict=True):
        if section.file is not None and not Path(section.file).is_absolute():
            table["file"] = Path(os.path.relpath(files.folder / section.file, folder)).as_posix()
    return tomlkit.dumps(document)
