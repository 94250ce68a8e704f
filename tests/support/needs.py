"""What some tests need of the machine: they are skipped with the reason where it is absent, or fail if it is required.

``CAROM_REQUIRE=pictures,browser,engines`` requires all, as CI does.
"""

from __future__ import annotations

import importlib
import os
import shutil
from functools import cache
from typing import Any

import pytest

from carom.errors import RecordingError

PICTURES, BROWSER, ENGINES = "pictures", "browser", "engines"
CHROMIUM = "/usr/bin/chromium"  # Debian's; Playwright's own browser is not downloaded
_REQUIRED = set(filter(None, os.environ.get("CAROM_REQUIRE", "").split(",")))
if unknown := _REQUIRED - {PICTURES, BROWSER, ENGINES}:
    raise ValueError(f"CAROM_REQUIRE: no {', '.join(sorted(unknown))}; it takes {PICTURES}, {BROWSER} and {ENGINES}")


def need(what: str) -> None:
    """Skip a test if something is absent; fail if it is required."""
    if reason := _missing(what):
        _end(what, reason)


def needed_engine(name: str) -> Any:
    """Import an engine's package, which the test needs."""
    try:
        return importlib.import_module(name)
    except ImportError:
        _end(ENGINES, f"the engine {name} is not installed")


def _end(what: str, reason: str) -> None:
    if what in _REQUIRED:
        pytest.fail(f"{reason} (CAROM_REQUIRE has {what})")
    pytest.skip(reason, allow_module_level=True)


@cache
def _missing(what: str) -> str:
    if what == BROWSER:
        return "" if shutil.which(CHROMIUM) else f"there is no {CHROMIUM}: apt-get install chromium"
    if what != PICTURES:
        raise ValueError(f"{what}: no such need")
    from carom.show.viewer import Viewer, virtual_screen  # noqa: PLC0415 - most tests need none

    try:
        for screen in ("", "100x100"):
            options = () if screen else ("--headless",)
            with Viewer(*options, "--window-size", "100x100", screen=screen) as viewer:
                viewer.screenshot()
    except RecordingError as error:
        return str(error)
    except FileNotFoundError:
        return f"there is no Xvfb: {virtual_screen()}"
    return ""
