"""Files that appear when they are complete: a full disk or an interrupt leaves the one that was there."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path


@contextlib.contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """Yield a path beside this one with the same ending; its file moves here on success and is removed on failure."""
    part = path.with_name(f".{path.stem}.part{path.suffix}")
    try:
        yield part
        part.replace(path)
    finally:
        with contextlib.suppress(OSError):
            part.unlink(missing_ok=True)


def write_whole(path: Path, text: str) -> None:
    """Write a text; OSError if it cannot be written."""
    with whole_file(path) as part:
        part.write_text(text, encoding="utf-8")
