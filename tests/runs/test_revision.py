"""The commit that is stamped into a recording, read without running what a repository names."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

import pytest

from carom.runs.environment import git_revision


def git(folder: Path, *arguments: str) -> str:
    who = ["-c", "user.name=a", "-c", "user.email=a@b", "-c", "init.defaultBranch=main"]
    return subprocess.run(
        ["git", *who, *arguments], cwd=folder, capture_output=True, text=True, check=True
    ).stdout.strip()


@pytest.fixture
def repository(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    folder = tmp_path / "repository"
    (folder / "below").mkdir(parents=True)
    (folder / "scene.toml").write_text("[[body]]\n", encoding="utf-8")
    git(folder, "init", f"--object-format={getattr(request, 'param', 'sha1')}")
    git(folder, "add", ".")
    git(folder, "commit", "-m", "first")
    return folder


@pytest.mark.parametrize("repository", ["sha1", "sha256"], indirect=True)
def test_the_revision_is_the_commit_with_a_mark_where_tracked_files_were_changed(repository: Path) -> None:
    commit = git(repository, "rev-parse", "HEAD")
    assert git_revision(repository / "below") == commit
    os.utime(repository / "scene.toml", (1, 1))
    (repository / "untracked").write_text("", encoding="utf-8")
    assert git_revision(repository) == commit
    (repository / "scene.toml").write_text("[[body]] # changed\n", encoding="utf-8")
    assert git_revision(repository) == f"{commit}-dirty"
    git(repository, "add", ".")
    assert git_revision(repository) == f"{commit}-dirty"


def test_the_revision_is_found_in_packed_refs_detached_heads_and_linked_working_trees(repository: Path) -> None:
    commit = git(repository, "rev-parse", "HEAD")
    git(repository, "pack-refs", "--all")
    git(repository, "gc", "-q")
    assert git_revision(repository) == commit
    git(repository, "worktree", "add", "-b", "other", "../linked")
    assert git_revision(repository.parent / "linked") == commit
    git(repository, "checkout", "--detach")
    assert git_revision(repository) == commit


def test_a_folder_without_a_commit_has_no_revision(tmp_path: Path) -> None:
    assert git_revision(tmp_path) == ""
    git(tmp_path, "init")
    assert git_revision(tmp_path) == ""
    (tmp_path / ".git" / "HEAD").unlink()
    os.mkfifo(tmp_path / ".git" / "HEAD")
    assert git_revision(tmp_path) == ""


@pytest.mark.parametrize("variable", ["GIT_DIR", "GIT_CONFIG_COUNT"])
def test_the_revision_does_not_depend_on_variables_for_git(
    variable: str, repository: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    commit = git(repository, "rev-parse", "HEAD")
    monkeypatch.setenv(variable, "nonsense")
    assert git_revision(repository) == commit


def test_no_program_that_a_repository_names_is_run(repository: Path, tmp_path: Path) -> None:
    trace, program = tmp_path / "trace", tmp_path / "program"
    program.write_text(f'#!/bin/sh\necho "$0 $*" >> {trace}\ncat\n', encoding="utf-8")
    program.chmod(0o755)
    submodule = repository / "submodule"
    submodule.mkdir()
    git(submodule, "init")
    git(submodule, "commit", "--allow-empty", "-m", "first")
    (repository / ".gitattributes").write_text("*.toml filter=evil diff=evil\n", encoding="utf-8")
    git(repository, "-c", "advice.addEmbeddedRepo=false", "add", ".")
    git(repository, "commit", "-m", "second")
    named = ["core.fsmonitor", "filter.evil.clean", "filter.evil.smudge", "diff.evil.textconv", "diff.evil.command"]
    named += ["diff.external", "core.pager", "core.sshCommand", "core.editor", "core.askPass", "gpg.program"]
    for folder in (repository, submodule):
        hooks = folder / ".git" / "hooks"
        hooks.mkdir(exist_ok=True)
        for hook in ("post-index-change", "fsmonitor-watchman"):
            (hooks / hook).write_bytes(program.read_bytes())
            (hooks / hook).chmod(0o755)
        for key in named:
            git(folder, "config", key, str(program))
    (repository / "scene.toml").write_text("[[BODY]]\n", encoding="utf-8")  # of the same length: it must be read
    (submodule / "new").write_text("", encoding="utf-8")
    git_says = subprocess.run(
        ["git", "describe", "--always", "--dirty"], cwd=repository, capture_output=True, check=False
    )
    assert git_says.stdout and trace.exists(), "the trap does not work"
    trace.unlink()
    assert git_revision(repository).endswith("-dirty")
    assert not trace.exists()
