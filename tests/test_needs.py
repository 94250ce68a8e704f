"""Tests that need what a machine does not have are skipped with the reason, and fail where it is required."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

import needs


@pytest.fixture(autouse=True)
def without_browser(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setattr(needs, "CHROMIUM", "/nowhere/chromium")
    monkeypatch.setattr(needs, "_REQUIRED", set())
    needs._missing.cache_clear()
    yield
    needs._missing.cache_clear()


def test_what_is_absent_is_the_reason_for_a_skip(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(pytest.skip.Exception, match="there is no /nowhere/chromium"):
        needs.need(needs.BROWSER)
    with pytest.raises(pytest.skip.Exception, match="the engine of_no_name is not installed"):
        needs.needed_engine("of_no_name")


def test_what_is_required_fails_where_it_is_absent(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(needs, "_REQUIRED", {needs.BROWSER, needs.ENGINES})
    with pytest.raises(pytest.fail.Exception, match="CAROM_REQUIRE has browser"):
        needs.need(needs.BROWSER)
    with pytest.raises(pytest.fail.Exception, match="CAROM_REQUIRE has engines"):
        needs.needed_engine("of_no_name")
