"""Imports an optional engine."""

from __future__ import annotations

import importlib
from importlib.metadata import PackageNotFoundError, version
from typing import Any

from carom.errors import RecordingError


def engine_package(name: str, distribution: str | None = None) -> Any:
    """Import an engine's package.

    Raises
    ------
    RecordingError
        If it is not installed, with the line that installs it.
    """
    try:
        return importlib.import_module(name)
    except ImportError:
        raise RecordingError(f"the engine {name} is not installed: pip install {distribution or name}") from None


def named_version(name: str, distribution: str | None = None) -> str:
    """Return the name and the version of an engine."""
    try:
        return f"{name} {version(distribution or name)}"
    except PackageNotFoundError:
        return name
