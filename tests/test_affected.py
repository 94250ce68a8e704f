"""The tests that `make check` runs for a change."""

from __future__ import annotations

import pytest

from affected import GOLDEN, ROOT, affected


@pytest.mark.parametrize(
    ("changed", "test"),
    [
        ("src/carom/physics/diagnostics/energy.py", "tests/physics/diagnostics/test_energy.py"),  # imports it
        ("src/carom/physics/contact/coulomb.py", f"{GOLDEN}[golden/heap]"),  # has kernels
        ("tests/support/monte_carlo_gas.py", "tests/published/test_granular_gas.py"),  # a module of tests
        ("tests/scene/test_explanation.py", "tests/scene/test_explanation.py"),  # a test
    ],
)
def test_a_change_takes_the_tests_that_are_about_it(changed: str, test: str) -> None:
    assert test in affected([changed])


def test_a_module_that_no_test_imports_takes_the_tests_of_those_that_do() -> None:
    assert "tests/test_affected.py" in affected(["tests/support/affected.py"])
    assert len(affected(["src/carom/lab/hunt/__init__.py"])) > 1


def test_what_is_taken_exists() -> None:
    assert all((ROOT / test.partition("::")[0]).is_file() for test in affected(["src/carom/physics/space.py"]))


def test_nothing_is_taken_where_nothing_changed() -> None:
    assert affected([]) == []
