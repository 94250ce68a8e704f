"""Chromium without a screen, in which the web viewer is looked at."""

from __future__ import annotations

import contextlib
import io
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from playwright.sync_api import Page, sync_playwright

CHROMIUM = "/usr/bin/chromium"  # Debian's; Playwright's own browser is not downloaded
OPTIONS = (
    *("--no-sandbox", "--no-first-run", "--disable-quic", "--disable-sync"),
    *("--disable-background-networking", "--disable-component-update"),
    *("--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"),  # WebGL in software
)
LOADED = 120_000  # ms; it takes 5 s on an idle machine
PAINTED = 60_000  # ms


@contextlib.contextmanager
def chromium(width: int = 800, height: int = 500) -> Iterator[tuple[Page, list[str]]]:
    """Give an empty page, and the list of what goes wrong in it: errors in the console, and exceptions."""
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=list(OPTIONS))
        try:
            page, errors = browser.new_page(viewport={"width": width, "height": height}), list[str]()
            page.on("console", lambda message: errors.append(message.text) if message.type == "error" else None)
            page.on("pageerror", lambda error: errors.append(str(error)))
            yield page, errors
        finally:
            browser.close()


def pixels_of(page: Page) -> NDArray[np.int64]:
    """Take a picture of the page, (height, width, 3)."""
    png = page.screenshot(timeout=PAINTED)
    return np.asarray(Image.open(io.BytesIO(png)).convert("RGB"), dtype=np.int64)
