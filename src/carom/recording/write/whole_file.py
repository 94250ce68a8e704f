"""Files that appear when they are complete: a full disk or an interrupt leaves the one that was there."""

from __future__ import annotations

import contextlib
import secrets
import shutil
from collections.abc import Iterator
from pathlib import Path

from carom.private_folder import is_fixed, temporary_folder


@contextlib.contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """Yield a new path with the same ending; its file moves to this one on success and is removed on failure.

    In a folder that is open to other users no link of theirs is followed: nobody can foresee the name, and where they
    could exchange the new file by its name, it is filled in the private folder.
    """
    with new_name(path, path.suffix) as part, contextlib.ExitStack() as stack:
        if is_fixed(path):
            part.open("xb").close()
            yield part
        else:
            filled = stack.enter_context(temporary_folder()) / path.name
            yield filled
            with filled.open("rb") as source, part.open("xb") as target:
                shutil.copyfileobj(source, target)
        part.replace(path)


@contextlib.contextmanager
def new_name(path: Path, ending: str) -> Iterator[Path]:
    """Yield an unused path beside another; remove what is there in the end. Open it with ``x``."""
    part = path.with_name(f".{path.stem}.{secrets.token_hex(4)}{ending}")
    try:
        yield part
    finally:
        with contextlib.suppress(OSError):
            part.unlink(missing_ok=True)


def write_whole(path: Path, text: str) -> None:
    """Write a text; OSError if it cannot be written."""
    with whole_file(path) as part:
        part.write_text(text, encoding="utf-8")
