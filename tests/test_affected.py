"""The tests that `make check` runs for a change: every row of the table exists, and every module has one."""

from __future__ import annotations

import pytest

from affected import DOCS, HEAP, ROOT, TESTS, affected


@pytest.mark.parametrize(
    ("changed", "test"),
    [
        ("src/carom/physics/diagnostics/energy.py", "tests/physics/diagnostics"),
        ("src/carom/physics/contact/coulomb.py", HEAP),
        ("src/carom/scene/load.py", "tests/scene/test_load.py"),  # its mirror
        ("tests/scene/test_explanation.py", "tests/scene/test_explanation.py"),  # a test
        ("src/carom/registry.py", "tests/test_removable.py"),
    ],
)
def test_a_change_takes_the_tests_that_are_about_it(changed: str, test: str) -> None:
    assert test in affected([changed])


def test_each_row_names_a_place_and_tests_that_exist() -> None:
    for place, tests in TESTS.items():
        assert any((ROOT / f"{place.rstrip('/')}{ending}").exists() for ending in ("", ".py")), place
        missing = [
            test for test in tests if not (ROOT / "tests" / test.removeprefix("tests/").partition("::")[0]).exists()
        ]
        assert not missing, place


def test_each_module_has_tests_of_its_package() -> None:
    everywhere = {f"tests/{test}" for test in TESTS["src/carom/"]} | {DOCS}
    modules = [path.relative_to(ROOT).as_posix() for path in (ROOT / "src" / "carom").glob("*/**/*.py")]
    assert [module for module in modules if set(affected([module])) <= everywhere] == []


def test_a_chosen_folder_includes_its_files() -> None:
    chosen = affected(["src/carom/lab/diff/diff.py", "tests/lab/diff/test_divergence.py"])
    assert "tests/lab/diff" in chosen and "tests/lab/diff/test_divergence.py" not in chosen


def test_nothing_is_taken_where_nothing_changed() -> None:
    assert affected([]) == []
