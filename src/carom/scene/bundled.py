"""The scenes that come with carom: `configs/` of the checkout, or its copy in the installed package."""

from __future__ import annotations

import tomllib
from pathlib import Path

PACKAGE = Path(__file__).parents[1]
CROSSCHECK = "crosscheck"  # the folder of scenes from bug reports of other engines
EXTREMES = "extremes"  # the folder of the numerical extremes, and the first part of their names


def bundled_scenes() -> dict[str, Path]:
    """Return the path of each bundled scene by its name, in order of the names."""
    return _scenes(_folder())


def extreme_scenes() -> dict[str, Path]:
    """Return the path of each numerical extreme by its name, such as ``extremes/mass-ratio``, in order of the names."""
    return {f"{EXTREMES}/{name}": path for name, path in _scenes(_folder() / EXTREMES).items()}


def crosscheck_scenes() -> dict[str, Path]:
    """Return the path of each scene of a bug report of another engine, such as ``crosscheck/jolt-higher-bounce``."""
    return {f"{CROSSCHECK}/{name}": path for name, path in _scenes(_folder() / CROSSCHECK).items()}


def bundled_folders() -> dict[str, list[str]]:
    """Return the names of the bundled scenes in each folder, by its name."""
    return {EXTREMES: list(extreme_scenes()), CROSSCHECK: list(crosscheck_scenes())}


def _scenes(folder: Path) -> dict[str, Path]:
    return {path.stem: path for path in sorted(folder.glob("*.toml"), key=lambda path: path.stem)}


def _folder() -> Path:
    installed = PACKAGE / "configs"
    return installed if installed.is_dir() else PACKAGE.parents[1] / "configs"


def data_files(scene: Path) -> list[Path]:
    """Return the data files of a bundled scene, which are beside it."""
    sections = tomllib.loads(scene.read_text(encoding="utf-8")).get("bodies", [])
    return [scene.with_name(section["file"]) for section in sections]


def starter() -> str:
    """Return the text of the commented scene that `carom new` writes."""
    return (Path(__file__).parent / "starter.toml").read_text(encoding="utf-8")
