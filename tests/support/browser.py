"""Headless Chromium for tests of the web viewer."""

from __future__ import annotations

import contextlib
import io
from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from needs import CHROMIUM

if TYPE_CHECKING:
    from playwright.sync_api import Page

OPTIONS = (
    *("--no-sandbox", "--no-first-run", "--disable-quic", "--disable-sync"),
    *("--disable-background-networking", "--disable-component-update"),
    *("--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"),  # WebGL in software
)
LOADED = 240_000  # ms; it takes 5 s on an idle machine, and 45 s beside five other processes
PAINTED = 60_000  # ms


@contextlib.contextmanager
def chromium(width: int = 800, height: int = 500) -> Iterator[tuple[Page, list[str]]]:
    """Yield an empty page, and the list of its errors: console messages and exceptions."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=list(OPTIONS))
        try:
            page, errors = browser.new_page(viewport={"width": width, "height": height}), list[str]()
            page.on("console", lambda message: errors.append(message.text) if message.type == "error" else None)
            page.on("pageerror", lambda error: errors.append(str(error)))
            yield page, errors
        finally:
            browser.close()


def wait_until_loaded(page: Page, errors: list[str]) -> None:
    """Wait until the viewer shows the recording; or else fail with what the page says."""
    from playwright.sync_api import TimeoutError

    try:
        page.wait_for_selector("body[data-state=loaded]", timeout=LOADED)
    except TimeoutError as error:
        raise AssertionError(f"not loaded: {page.inner_text('#progress')!r}, {errors}") from error


def settled(page: Page) -> NDArray[np.int64]:
    """Take a picture of the page once it has stopped changing, or after a minute, (height, width, 3)."""
    now = pixels_of(page)
    for _ in range(20):
        page.wait_for_timeout(3000)
        before, now = now, pixels_of(page)
        if np.array_equal(before, now):
            break
    return now


def pixels_of(page: Page) -> NDArray[np.int64]:
    """Take a picture of the page, (height, width, 3)."""
    png = page.screenshot(timeout=PAINTED)
    return np.asarray(Image.open(io.BytesIO(png)).convert("RGB"), dtype=np.int64)
