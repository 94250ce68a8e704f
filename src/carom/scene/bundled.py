"""The scenes that come with carom: `configs/` of the checkout, or its copy in the installed package."""

from __future__ import annotations

from pathlib import Path

PACKAGE = Path(__file__).parents[1]


def bundled_scenes() -> dict[str, Path]:
    """Return the path of each bundled scene by its name, in order of the names."""
    return {path.stem: path for path in sorted(_folder().glob("*.toml"))}


def _folder() -> Path:
    installed = PACKAGE / "configs"
    return installed if installed.is_dir() else PACKAGE.parents[1] / "configs"


def starter() -> str:
    """Return the text of the commented scene that a person may start from."""
    return (Path(__file__).parent / "starter.toml").read_text(encoding="utf-8")
