"""Requirements of tests: a test is skipped with the reason where one is absent, or fails where it is required.

A need is ``pictures`` (a Vulkan driver and Xvfb), ``browser`` (Chromium and Playwright), or a package of an extra, by
the name by which it is imported. ``CAROM_REQUIRE=engines,extras,pictures,browser`` requires all, as CI does.
"""

from __future__ import annotations

import importlib.util
import os
import shutil
from functools import cache

import pytest

from carom.errors import RecordingError

PICTURES, BROWSER = "pictures", "browser"
CHROMIUM = "/usr/bin/chromium"  # Debian's; Playwright's own browser is not downloaded
PACKAGES = {  # by what CAROM_REQUIRE calls them
    "engines": ("mujoco", "newton", "rebound"),
    "extras": (
        *("datafusion", "distributed", "gsd", "h5py", "imageio_ffmpeg", "matplotlib", "nbclient", "rerun_notebook"),
        "trimesh",
    ),
}
GROUPS = {PICTURES: PICTURES, BROWSER: BROWSER} | {name: group for group, names in PACKAGES.items() for name in names}
_REQUIRED = set(filter(None, os.environ.get("CAROM_REQUIRE", "").split(",")))
if unknown := _REQUIRED - {PICTURES, BROWSER, *PACKAGES}:
    raise ValueError(f"CAROM_REQUIRE: no {', '.join(unknown)}; it takes {', '.join((PICTURES, BROWSER, *PACKAGES))}")


def missing_though_required() -> list[str]:
    """Return the packages that are required and not installed."""
    return [name for name, group in GROUPS.items() if group in _REQUIRED and name != group and _missing(name)]


def need(what: str) -> None:
    """Skip a test if something is absent; fail if it is required."""
    if reason := _missing(what):
        if GROUPS[what] in _REQUIRED:
            pytest.fail(f"{reason} (CAROM_REQUIRE has {GROUPS[what]})")
        pytest.skip(reason)


@cache
def _missing(what: str) -> str:
    if what not in GROUPS:
        raise ValueError(f"{what}: no such need; tests/support/needs.py has them")
    if what != PICTURES:
        package = "playwright" if what == BROWSER else what
        if importlib.util.find_spec(package) is None:
            return f"{package} is not installed: pip install '.[full]'"
        if what == BROWSER and not shutil.which(CHROMIUM):
            return f"there is no {CHROMIUM}: apt-get install chromium"
        return ""
    from carom.display.viewer import Viewer, virtual_screen

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
