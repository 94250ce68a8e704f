"""The run that most tests here record."""

from __future__ import annotations

import pytest

from merry import Merry


@pytest.fixture
def merry() -> Merry:
    return Merry()
