"""The exceptions that carom raises, each with a sentence for a person, and the commands that install missing packages.

Users need the four classes in ``__all__``. The other classes are kinds of `RecordingError` that callers inside carom
distinguish.
"""

from __future__ import annotations

import contextlib
import importlib.util
import re
import shlex
import shutil
import sys
from collections.abc import Iterator
from pathlib import Path

__all__ = ["ExperimentError", "PhysicsError", "RecordingError", "SceneError"]


class SceneError(ValueError):
    """A scene cannot be simulated as written; the message names the place, the mistake and a valid value.

    Parameters
    ----------
    message
        The sentence.
    key
        The key in question, such as ``("group", 0, "region")``, if its place is unknown where the error is raised.
        `naming_places` then puts the place before the message.
    """

    def __init__(self, message: str, key: tuple[str | int, ...] = ()) -> None:
        super().__init__(message)
        self.key = key


class PhysicsError(RuntimeError):
    """The run cannot continue: the state is not finite, or the step is too small to change the clock."""


class ExperimentError(Exception):
    """A request cannot be fulfilled; the message has the reason and the remedy."""


class RecordingError(Exception):
    """A recording cannot be written, read or shown; the message is one sentence with the reason."""


class RecorderError(RecordingError):
    """An error of the program or of an extension, or lack of memory, stopped the recorder; its file is closed."""


class DroppedRunWarning(UserWarning):
    """A new run replaces the file that a killed run left; the message names it."""


class ExistsError(RecordingError):
    """A file would be replaced without permission."""

    def __init__(self, path: Path) -> None:
        super().__init__(f"{path}: exists; give force=True to replace it")
        self.path = path


class NotRecordedError(RecordingError):
    """The recording lacks requested data. `carom.rerun` computes these, unless another engine made the run."""

    def __init__(self, path: Path, what: str, engine: str = "") -> None:
        remedy = f"it was recorded from {engine}, which carom cannot rerun" if engine else "carom.rerun computes it"
        super().__init__(f"{path} does not hold {what}; {remedy}")


class DamageError(RecordingError):
    """A part of a file is damaged; the message names the part, but not the file."""


class TornFooterError(DamageError):
    """A file ends inside its footer: nothing but the index is lost."""


def status_of(error: RecordingError) -> str:
    """Return the status of a run whose recording failed: "error" for a program or a damaged file, else "disk"."""
    damaged = isinstance(error, DamageError) or isinstance(error.__cause__, DamageError)
    return "error" if damaged or isinstance(error, RecorderError) else "disk"


_EXTRA = re.compile(r"""extra\s*==\s*["']([\w-]+)["']""")


def install_extra(extra: str) -> str:
    """Return the command that installs the packages of an extra into the environment of this process.

    The command lists the packages themselves, because carom may have been installed from a folder or an archive.
    """
    from importlib.metadata import requires  # noqa: PLC0415 - takes 20 ms, which few processes need

    wanted = list[str]()
    for requirement in requires("carom") or ():
        package, _, marker = requirement.partition(";")
        if (of_extra := _EXTRA.search(marker)) and of_extra[1] == extra:
            wanted.append(package.strip())
    packages = shlex.join(wanted or [f"carom[{extra}]"])
    if "pipx" in Path(sys.prefix).parts:
        return f"pipx inject carom {packages}"
    if importlib.util.find_spec("pip") is None:
        return f"uv pip install --python {shlex.quote(sys.executable)} {packages}"
    pip = shutil.which("pip")
    if pip is not None and Path(pip).parent == Path(sys.executable).parent:
        return f"pip install {packages}"
    return f"{shlex.quote(sys.executable)} -m pip install {packages}"


def install_packages(debian: str, fedora: str) -> str:
    """Return the command that installs packages of the system, by their names in two families of distributions."""
    if shutil.which("apt-get"):
        return f"apt-get install {debian}"
    if shutil.which("dnf"):
        return f"dnf install {fedora}"
    return f"install {debian} (Debian's names) or {fedora} (Fedora's)"


@contextlib.contextmanager
def needing(extra: str, command: str, *packages: str) -> Iterator[None]:
    """Import packages of an extra within this context; raise ExperimentError with the remedy if one is missing."""
    try:
        yield
    except ModuleNotFoundError as error:
        if (error.name or "").split(".")[0] not in packages:
            raise
        raise ExperimentError(f"{command} needs {packages[0]}: {install_extra(extra)}") from None
