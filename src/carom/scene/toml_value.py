"""One value as on the command line: TOML, or a bare word."""

from __future__ import annotations

import re
from typing import Any

import tomlkit
import tomlkit.exceptions

_NUMBER = re.compile(r"[+-]?(\.[0-9]+|[0-9]+\.)([eE][+-]?[0-9]+)?")  # as people write it, and TOML does not


def parse_value(text: str) -> Any:
    """Read a TOML value; a bare word is a string."""
    try:
        return tomlkit.value(text).unwrap()
    except (tomlkit.exceptions.TOMLKitError, ValueError):
        return float(text) if _NUMBER.fullmatch(text) else text
