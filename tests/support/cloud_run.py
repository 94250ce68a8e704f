"""A run that several tests read."""

from __future__ import annotations

from pathlib import Path

import pytest

import carom
from carom.recording.read.recording import Recording
from small_scenes import cloud


@pytest.fixture(scope="session")
def cloud_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return carom.run(cloud(), tmp_path_factory.mktemp("cloud") / "cloud.rrd").path


@pytest.fixture
def cloud_run(cloud_file: Path) -> Recording:
    """The whole run of `cloud()`; its file must not be written to."""
    return Recording.open(cloud_file)
