"""The environment of a run, and the settings of its process.

The commit is read without running any program that the folder configures. The working folder may come from a stranger.
If Git ran in it, Git would obey its `.git/config`, which may name programs to run: monitors, hooks, filters,
transports. The commit is therefore read from the files of the repository. To compare tracked files with the commit, Git
runs in a temporary repository that uses the folder's objects and index.

Signals come from Ctrl-C, from job schedulers and from closed terminals.
"""

from __future__ import annotations

import contextlib
import ctypes
import gc
import importlib.metadata
import os
import platform
import re
import shlex
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from types import FrameType
from typing import Any, NoReturn, Self

from carom.held_signals import ENDING
from carom.private_folder import remove_private_folder, temporary_folder

PACKAGES = ("carom", "rerun-sdk", "numpy", "scipy", "numba")
_ABSOLUTE = re.compile(r"^([\w.-]+=)?/(?:.*/)?")  # a path, or an option or key whose value is a path


def versions(further: Mapping[str, str] | None = None) -> dict[str, str]:
    """Return the versions of Python, of the packages that a result depends on, and of ``further`` packages."""
    own = {package: _version(package) for package in PACKAGES}
    return {"python": platform.python_version(), **own, **(further or {})}


def environment(threads: int, further: Mapping[str, str] | None = None) -> dict[str, str | int]:
    """Return the recording's properties about its origin; ``further`` has versions of packages, by their names."""
    return {
        **{f"version.{package}": version for package, version in versions(further).items()},
        "command": command_line(),
        "git": _revision(),
        "platform": platform.platform(),
        "cpu": _cpu(),
        "threads": threads,
    }


def command_line() -> str:
    """Return the command line without the folders of absolute paths, since recordings are shared."""
    program = Path(sys.argv[0])
    name = "carom" if program.name == "__main__.py" and program.parent.name == "carom" else program.name
    return shlex.join([name, *(_ABSOLUTE.sub(r"\1", word) for word in sys.argv[1:])])


@cache
def _version(package: str) -> str:
    """Return the installed version, cached: a lookup takes a millisecond or two, and each run of a sweep repeats it."""
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return "unknown"


@cache
def _revision() -> str:
    """Return the commit of the working folder at the first call, cached because a sweep needs it for every run."""
    return git_revision(Path.cwd())


@cache
def _cpu() -> str:
    try:
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    except OSError:
        pass
    return platform.processor() or platform.machine()


_HASH = re.compile(r"[0-9a-f]{40}|[0-9a-f]{64}")  # SHA-1 or SHA-256
_BRANCH = re.compile(r"ref: (refs/.+)")
_SHA1 = 40  # number of digits
_LONGEST = 4096  # largest number of characters of a file with one line
_TIME = 5  # s, time limit of Git
_CONFIG = "[core]\nrepositoryformatversion = 0\n"
_CONFIG_SHA256 = "[core]\nrepositoryformatversion = 1\n[extensions]\nobjectformat = sha256\n"
_COMPARE = ("diff", "--quiet", "--no-ext-diff", "--no-textconv", "--ignore-submodules=all", "HEAD", "--")


@dataclass(frozen=True, slots=True)
class _Repository:
    root: Path
    folder: Path  # HEAD and index of this working tree
    common: Path  # objects and refs of all working trees


def git_revision(folder: Path) -> str:
    """Return the commit that is checked out in a folder; empty if there is none.

    "-dirty" is appended if tracked files differ from the commit, "-unchecked" if Git failed to compare them.
    """
    try:
        repository = _repository_around(folder.resolve())
        commit = _commit(repository) if repository else ""
    except (OSError, ValueError):
        return ""
    return commit + _changes(repository, commit) if repository and commit else ""


def _repository_around(folder: Path) -> _Repository | None:
    for root in (folder, *folder.parents):
        git = root / ".git"
        if git.is_file():  # a linked working tree or a submodule has a file in place of the folder
            git = root / _line(git).removeprefix("gitdir: ")
        if git.is_dir():
            linked = git / "commondir"
            return _Repository(root, git, git / _line(linked) if linked.is_file() else git)
    return None


def _commit(repository: _Repository) -> str:
    head = _line(repository.folder / "HEAD")
    branch = _BRANCH.fullmatch(head)
    if branch is None:
        return head if _HASH.fullmatch(head) else ""
    loose, packed = repository.common / branch[1], repository.common / "packed-refs"
    found = _line(loose)
    if not loose.is_file() and packed.is_file():
        with packed.open(encoding="utf-8") as lines:
            found = next((line.split()[0] for line in lines if line.endswith(f" {branch[1]}\n")), "")
    return found if _HASH.fullmatch(found) else ""


def _line(path: Path) -> str:
    if not path.is_file():  # reading a pipe would block
        return ""
    with path.open(encoding="utf-8") as file:
        return file.read(_LONGEST).strip()


def _changes(repository: _Repository, commit: str) -> str:
    """Ask Git whether tracked files differ from the commit, in a repository with our own configuration."""
    try:
        with temporary_folder() as ours:
            (ours / "refs").mkdir()
            (ours / "HEAD").write_text(commit + "\n", encoding="ascii")
            config = _CONFIG if len(commit) == _SHA1 else _CONFIG_SHA256
            (ours / "config").write_text(config, encoding="ascii")
            inherited = {name: value for name, value in os.environ.items() if not name.startswith("GIT_")}
            borrowed = {
                "GIT_DIR": str(ours),
                "GIT_WORK_TREE": str(repository.root),
                "GIT_INDEX_FILE": str(repository.folder / "index"),
                "GIT_OBJECT_DIRECTORY": str(repository.common / "objects"),
                "GIT_OPTIONAL_LOCKS": "0",  # keeps Git from writing the index
                "GIT_NO_LAZY_FETCH": "1",
            }
            asked = subprocess.run(
                ["git", *_COMPARE],
                cwd=repository.root,
                env=inherited | borrowed,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
                timeout=_TIME,
                check=False,
            )
    except (OSError, subprocess.TimeoutExpired):
        return "-unchecked"
    return {0: "", 1: "-dirty"}.get(asked.returncode, "-unchecked")


AFTER_CALLBACK = 0.05  # s from a callback to the repeated signal; llvmlite's callbacks for a kernel take microseconds
LONGEST_IMPORT = 10.0  # s, longest wait of a signal for an import; the longest import takes a second
# s within which interrupts count once: wrappers such as `uv run` also forward the terminal's interrupt
SAME_PRESS = 0.3

_ARENA_MAX, _TRIM_THRESHOLD, _MMAP_THRESHOLD = -8, -1, -3  # glibc's <malloc.h>
_KEPT = 512 << 20  # bytes of free memory to keep
_LARGE = 64 << 20  # bytes above which arrays get pages of their own
_NEW_OBJECTS = 100_000  # new objects between collections; the first batches create 60 000, mostly modules, which remain

_received: list[int] = []  # the signal, if any, that was raised as KeyboardInterrupt
_heard: list[float] = []  # s, times at which this command was asked to end, in order
_waiting: list[float] = []  # s, time of a request, if any, during an import


def raise_signals(before: Sequence[Any] = ()) -> None:
    """Make the first signal that would end this process raise KeyboardInterrupt in the main thread, like Ctrl-C.

    Later signals find the command already ending; see `_raise`. The handlers ``before`` are replaced, too.
    """
    for number in (signal.SIGINT, *ENDING):
        if signal.getsignal(number) in (signal.SIG_DFL, signal.default_int_handler, *before):  # nohup ignores SIGHUP
            signal.signal(number, _raise)
    sys.unraisablehook = _raise_later


def is_ending(*, at_once: bool = False) -> None:
    """Tell the handlers that the command ends by itself: no signal raises from now on.

    When it ends ``at_once``, signals are ignored: the interpreter would restore their default actions before it has
    ended, and a late signal would then change the exit code.
    """
    _heard.append(time.monotonic())
    for number in (signal.SIGINT, *ENDING) if at_once else ():
        if signal.getsignal(number) is _raise:
            signal.signal(number, signal.SIG_IGN)


def received() -> int:
    """Return the signal that was raised as KeyboardInterrupt; 0 if none was."""
    return _received[0] if _received else 0


def _raise(number: int, frame: FrameType | None) -> None:
    """Raise KeyboardInterrupt at the first request to end; drop its repetition; end at once at a later request.

    Wrappers and schedulers send the same request twice. A second exception, within the clean-up after the first one or
    after a run that a signal has ended, would print a traceback and another exit code.
    """
    now = time.monotonic()
    if not _heard and _is_importing(frame):
        _waiting.append(now)
        if now - _waiting[0] < LONGEST_IMPORT:
            _send_later(number)
            return
    again = now - _heard[-1] if _heard else None
    _heard.append(now)
    if again is None:
        _received.append(number)
        raise KeyboardInterrupt
    if again >= SAME_PRESS and (number == signal.SIGINT or received()):
        leave(number)


def _is_importing(frame: FrameType | None) -> bool:
    """Return whether a frame is within an import; an exception would leave the import half done, or be printed."""
    while frame is not None and not frame.f_code.co_filename.startswith("<frozen importlib"):
        frame = frame.f_back
    return frame is not None


def _send_later(number: int) -> None:
    """Send a signal to the main thread again, soon."""
    later = threading.Timer(AFTER_CALLBACK, signal.pthread_kill, (threading.main_thread().ident, number))
    later.daemon = True
    later.start()


def leave(number: int = 0) -> NoReturn:
    """End a command at once after a signal, without unwinding: closing Rerun's streams may never return."""
    with contextlib.suppress(Exception):  # the disk is full, or the signal arrived within a write to the same stream
        sys.stdout.flush()
    with contextlib.suppress(OSError):
        os.write(2, b"carom: interrupted\n")
    remove_private_folder()
    os._exit(128 + (received() or number))


def _raise_later(lost: sys.UnraisableHookArgs) -> None:
    """Raise again an interrupt that C code dropped because the interrupt arrived within a callback."""
    if lost.exc_type is not KeyboardInterrupt or not received():
        sys.__unraisablehook__(lost)
        return
    _heard.clear()  # drop an earlier signal of the same request
    _send_later(received())


class Interrupts:
    """Counts requests to end while its context lasts, in the main thread only.

    The handler raises nothing until the interrupt key has been pressed more often than ``patience``, so that work is
    not interrupted. Other signals count once, because their senders repeat them.

    Parameters
    ----------
    patience
        Number of presses of the interrupt key that raise nothing.
    """

    def __init__(self, patience: int = 1) -> None:
        self.count = 0
        self.sender = "the user"
        self._patience = patience
        self._presses = 0
        self._last = -SAME_PRESS  # s, time at which the interrupt key was last pressed
        self._before: dict[int, Any] = {}

    def __enter__(self) -> Self:
        if threading.current_thread() is threading.main_thread():
            if received():  # a library caught the exception during its import
                raise KeyboardInterrupt
            known = (signal.SIG_DFL, signal.default_int_handler, _raise)
            for number in (signal.SIGINT, *ENDING):
                if signal.getsignal(number) in known:
                    self._before[number] = signal.signal(number, self._see)
        return self

    def __exit__(self, *_: object) -> None:
        if self.count and _raise in self._before.values() and not _heard:  # the command ends without an exception
            is_ending()
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def _see(self, number: int, frame: FrameType | None) -> None:
        if number != signal.SIGINT:
            if self.count == 0:
                self.count, self.sender = 1, signal.Signals(number).name
            return
        now = time.monotonic()
        if now - self._last >= SAME_PRESS:
            self.count += 1
            self._presses += 1
        self._last = now
        if self._presses > self._patience:
            if self._before.get(number) is _raise:  # a command's exit code names the signal
                _raise(number, frame)
            raise KeyboardInterrupt  # a program may catch it and start another run


def keep_freed_memory() -> None:
    """Keep freed memory for the next frame, in one pool for all threads; without glibc, do nothing.

    This must be called before other threads exist, because threads that NumPy starts keep pools of their own.
    """
    if not sys.platform.startswith("linux"):
        return
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (AttributeError, OSError):  # another C library
        return
    for option, value in ((_ARENA_MAX, 1), (_TRIM_THRESHOLD, _KEPT), (_MMAP_THRESHOLD, _LARGE)):
        mallopt(option, value)


def leave_pandas_out() -> None:
    """Keep pyarrow from importing pandas in a process of carom: 0.15 to 0.2 s of CPU.

    At its first conversion of an array, pyarrow imports pandas if it is installed, to recognise its series. carom has
    no pandas series. A later conversion of a table to pandas still works: pyarrow then tries the import again.
    """
    import pyarrow as pa  # noqa: PLC0415 - `carom --help` does without

    class Refusing:
        @staticmethod
        def find_spec(name: str, path: object = None, target: object = None) -> None:
            if name == "pandas":
                raise ImportError(name)

    if "pandas" not in sys.modules:
        sys.meta_path.insert(0, Refusing)
        try:
            pa.array([0])
        finally:
            sys.meta_path.remove(Refusing)


def collect_garbage_rarely() -> None:
    """Let Python collect cyclic garbage after 100 000 new objects instead of 700, unless the program collects none.

    There is hardly any cyclic garbage, since frames and rows have no cycles. A full collection takes 0.1 s, in which
    the physics waits for the interpreter lock, and small collections took 50 µs in each frame of 1000 bodies (both on a
    busy machine). Collections also take a tenth of the time of a compilation: without collections, two runs of
    `cloud-collapse` took 38.5 and 41.9 instead of 42.7 and 46.6 s of CPU, and 4 to 18 % more memory.
    """
    threshold, *others = gc.get_threshold()
    if threshold:
        gc.set_threshold(max(_NEW_OBJECTS, threshold), *others)


@contextlib.contextmanager
def collecting_garbage_rarely() -> Iterator[None]:
    """Collect garbage rarely for a while, in the process of a user's program."""
    before = gc.get_threshold()
    collect_garbage_rarely()
    try:
        yield
    finally:
        gc.set_threshold(*before)
