"""Every command without extras: it works, or names the package to install."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from carom.cli.main import COMMANDS
from main_paths import EXTRAS, FIRST, PATHS, fault_of, without_screen_and_driver


@pytest.fixture(scope="module")
def environment(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """An environment in which the packages of the extras cannot be imported, by no process."""
    blocked = tmp_path_factory.mktemp("blocked")
    for name in EXTRAS:
        missing = f"raise ModuleNotFoundError('No module named {name!r}', name={name!r})\n"
        (blocked / f"{name}.py").write_text(missing.replace(f"named {name!r}'", f"named {name}'"), encoding="utf-8")
    path = os.pathsep.join(filter(None, (str(blocked), os.environ.get("PYTHONPATH"))))
    return without_screen_and_driver() | {"PYTHONPATH": path}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory, environment: dict[str, str]) -> Path:
    """A folder with a recording."""
    folder = tmp_path_factory.mktemp("paths")
    assert not fault_of(FIRST, PATHS[FIRST][0], folder, environment)
    return folder


def test_the_main_path_of_every_command_is_listed() -> None:
    assert set(PATHS) == {name for panel in COMMANDS.values() for name in panel}


@pytest.mark.slow
@pytest.mark.parametrize("command", [name for name in PATHS if name != FIRST])
def test_a_command_works_without_extras_or_names_the_one_that_it_needs(
    command: str, folder: Path, environment: dict[str, str]
) -> None:
    for path in PATHS[command]:
        assert not (fault := fault_of(command, path, folder, environment)), fault
