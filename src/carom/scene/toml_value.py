"""One value as on the command line: TOML, or a bare word."""

from __future__ import annotations

from typing import Any

import tomlkit
import tomlkit.exceptions


def parse_value(text: str) -> Any:
    """Read a TOML value; a bare word is a string."""
    try:
        return tomlkit.value(text).unwrap()
    except (tomlkit.exceptions.TOMLKitError, ValueError):
        return text
