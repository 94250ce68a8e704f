"""Scenes of one data file, for the tests of their formats."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from carom.errors import SceneError
from carom.scene.load import Scene

SAMPLES = Path(__file__).parents[1] / "scene" / "data" / "samples"  # files as people have them


def scene_of(folder: Path, file: str, more: str = "", top: str = "") -> Scene:
    """Load a scene of a file in a folder, or of a sample with that name."""
    if (SAMPLES / file).exists():
        shutil.copy(SAMPLES / file, folder)
    (folder / "scene.toml").write_text(f'{top}\n[[bodies]]\nfile = "{file}"\n{more}\n', encoding="utf-8")
    return Scene.load(folder / "scene.toml")


def refusal(folder: Path, file: str, more: str = "", top: str = "") -> str:
    """Return the one sentence that refuses such a scene."""
    with pytest.raises(SceneError) as caught:
        scene_of(folder, file, more, top)
    assert "\n" not in str(caught.value)
    return str(caught.value)
