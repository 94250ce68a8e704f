"""Tests that need what a machine does not have are skipped with the reason, and fail where it is required."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

import needs


@pytest.fixture(autouse=True)
def without_browser_and_engine(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setattr(needs, "CHROMIUM", "/nowhere/chromium")
    monkeypatch.setattr(needs, "GROUPS", {**needs.GROUPS, "of_no_name": "engines"})
    monkeypatch.setattr(needs, "_REQUIRED", set())
    needs._missing.cache_clear()
    yield
    needs._missing.cache_clear()


@pytest.mark.needs(needs.BROWSER)
def test_a_browser_that_is_absent_is_the_reason_for_a_skip() -> None:
    with pytest.raises(pytest.skip.Exception, match="there is no /nowhere/chromium"):
        needs.need(needs.BROWSER)


def test_a_package_that_is_absent_is_the_reason_for_a_skip() -> None:
    with pytest.raises(pytest.skip.Exception, match="of_no_name is not installed"):
        needs.need("of_no_name")


def test_what_is_required_fails_where_it_is_absent(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(needs, "_REQUIRED", {"engines"})
    with pytest.raises(pytest.fail.Exception, match=r"of_no_name is not installed.*CAROM_REQUIRE has engines"):
        needs.need("of_no_name")


def test_a_need_that_is_not_listed_is_a_mistake() -> None:
    with pytest.raises(ValueError, match="no such need"):
        needs.need("a miracle")
