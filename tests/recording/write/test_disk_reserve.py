"""Disk space reserved for the end of a recording, with and without support by the system."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from carom.recording.write.durable_sink import DiskReserve


@pytest.mark.parametrize("helped", [True, False])
def test_the_reserve_takes_its_size_on_the_disk(helped: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    if not helped:
        monkeypatch.delattr(os, "posix_fallocate")
    reserve = DiskReserve(tmp_path)
    for size in (100_000, 50_000, 300_000):
        reserve.grow(size)
    assert reserve.size == 300_000
    assert os.fstat(reserve._file.fileno()).st_blocks * 512 >= 300_000
    reserve.release()
