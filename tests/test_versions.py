"""The versions that pyproject.toml promises are those that CI installs."""

from __future__ import annotations

import tomllib
from pathlib import Path

from packaging.requirements import Requirement
from packaging.version import Version

HERE = Path(__file__).parent.parent
PROJECT = tomllib.loads((HERE / "pyproject.toml").read_text(encoding="utf-8"))["project"]
EXTRAS = PROJECT["optional-dependencies"]
LOWEST = {
    requirement.name: Version(next(iter(requirement.specifier)).version)
    for line in (HERE / ".ci" / "lowest.txt").read_text(encoding="utf-8").splitlines()
    if line and not line.startswith("#")
    for requirement in [Requirement(line)]
}


def bounds(requirements: list[str]) -> dict[str, Version]:
    """Return the lowest version of each that is allowed."""
    found = {}
    for requirement in map(Requirement, requirements):
        (lowest,) = (one.version for one in requirement.specifier if one.operator in (">=", "~="))
        found[requirement.name] = Version(lowest)
    return found


def test_ci_installs_the_lowest_version_of_every_dependency() -> None:
    dependencies = bounds(PROJECT["dependencies"])
    assert {name: LOWEST.get(name) for name in dependencies} == dependencies


def test_the_tools_that_ci_tests_the_lowest_versions_with_are_the_lowest_ones_too() -> None:
    allowed = bounds(PROJECT["dependencies"]) | bounds(EXTRAS["dev"]) | bounds(EXTRAS["movie"])
    assert {name: allowed.get(name) for name in LOWEST} == LOWEST
