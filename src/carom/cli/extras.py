"""What a command needs that a plain `pip install carom` does not bring."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

from carom.errors import ExperimentError
from carom.install import install_extra


@contextlib.contextmanager
def needing(extra: str, command: str, *packages: str) -> Iterator[None]:
    """Import the packages of an extra within this context; ExperimentError with the remedy if one is missing."""
    try:
        yield
    except ModuleNotFoundError as error:
        if (error.name or "").split(".")[0] not in packages:
            raise
        raise ExperimentError(f"{command} needs {packages[0]}: {install_extra(extra)}") from None
