"""Turns every error in reading a file into one sentence with the file and the remedy."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pyarrow as pa

from carom.errors import DamageError, RecordingError
from carom.recording.rrd.framing import looks_recorded
from carom.scene.wording import command

# Exceptions that a wrong name, type or length in a file may raise.
_SURPRISES = (
    *(LookupError, ValueError, TypeError, AttributeError, ArithmeticError, MemoryError, RecursionError),
    pa.ArrowException,
)


@contextmanager
def reading(path: Path) -> Iterator[None]:
    """Replace exceptions by a RecordingError with the name of the file and the remedy.

    Raises
    ------
    RecordingError
        In place of an exception raised inside.
    """
    try:
        yield
    except DamageError as error:
        raise RecordingError(_damaged(path, str(error))) from error
    except RecordingError:
        raise
    except OSError as error:
        raise RecordingError(f"cannot read {path}: {error.strerror or error}") from error
    except _SURPRISES as error:
        raise RecordingError(_damaged(path, f"{type(error).__name__}: {error}".splitlines()[0])) from error


def _damaged(path: Path, reason: str) -> str:
    if not looks_recorded(path):
        if path.suffix == ".toml":
            return f"{path} is a scene, not a recording; `{command('run', path)}` records it"
        return f"{path} is not a recording ({reason})"
    return f"{path} is not a recording, or is damaged ({reason}); `{command('repair', path)}` saves what can be read"
