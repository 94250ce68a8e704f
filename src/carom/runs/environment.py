"""The environment of a run: versions, machine, command, and the commit of the working folder.

The commit is read without running any program that the folder configures. The working folder may come from a stranger.
If Git ran in it, Git would obey its `.git/config`, which may name programs to run: monitors, hooks, filters,
transports. The commit is therefore read from the files of the repository. To compare tracked files with it, Git runs in
a temporary repository that uses the objects and the index of the folder.
"""

from __future__ import annotations

import importlib.metadata
import os
import platform
import re
import shlex
import subprocess
import sys
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from carom.private_folder import temporary_folder

PACKAGES = ("carom", "rerun-sdk", "numpy", "scipy", "numba")
_ABSOLUTE = re.compile(r"^([\w.-]+=)?/(?:.*/)?")  # a path, or an option or a key that holds one


def versions() -> dict[str, str]:
    """Return the versions of Python and of the packages that a result depends on."""
    return {"python": platform.python_version(), **{package: _version(package) for package in PACKAGES}}


def environment(threads: int) -> dict[str, str | int]:
    """Return the recording's properties about its origin."""
    stamped: dict[str, str | int] = {f"version.{package}": version for package, version in versions().items()}
    stamped["command"] = command_line()
    stamped["git"] = _revision()
    stamped["platform"] = platform.platform()
    stamped["cpu"] = _cpu()
    stamped["threads"] = threads
    return stamped


def command_line() -> str:
    """Return the command line without the folders of absolute paths, since recordings are shared."""
    program = Path(sys.argv[0])
    name = "carom" if program.name == "__main__.py" and program.parent.name == "carom" else program.name
    return shlex.join([name, *(_ABSOLUTE.sub(r"\1", word) for word in sys.argv[1:])])


@cache
def _version(package: str) -> str:
    """Return the installed versions, cached: a lookup takes a millisecond or two, and sweeps repeat it every run."""
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
_LONGEST = 4096  # characters of a file that holds one line
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

    "-dirty" is appended if tracked files differ from it, "-unchecked" if Git failed to compare them.
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
        if git.is_file():  # of a linked working tree or a submodule
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
    loose = repository.common / branch[1]
    found = _line(loose) if loose.is_file() else _packed(repository.common / "packed-refs", branch[1])
    return found if _HASH.fullmatch(found) else ""


def _packed(path: Path, branch: str) -> str:
    if not path.is_file():
        return ""
    with path.open(encoding="utf-8") as lines:
        return next((line.split()[0] for line in lines if line.endswith(f" {branch}\n")), "")


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
            config = _CONFIG if len(commit) == 40 else _CONFIG_SHA256
            (ours / "config").write_text(config, encoding="ascii")
            inherited = {name: value for name, value in os.environ.items() if not name.startswith("GIT_")}
            borrowed = {
                "GIT_DIR": str(ours),
                "GIT_WORK_TREE": str(repository.root),
                "GIT_INDEX_FILE": str(repository.folder / "index"),
                "GIT_OBJECT_DIRECTORY": str(repository.common / "objects"),
                "GIT_OPTIONAL_LOCKS": "0",  # so that the index is not written
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
