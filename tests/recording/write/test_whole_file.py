"""Files that appear when they are complete, also in folders in which others can write."""

from __future__ import annotations

from pathlib import Path

import pytest

from carom.private_folder import private_folder
from carom.recording.write.whole_file import whole_file, write_whole


@pytest.mark.parametrize("mode", [0o755, 0o1777, 0o777])
def test_links_that_others_planted_are_replaced_and_not_followed(tmp_path: Path, mode: int) -> None:
    shared, mine = tmp_path / "shared", tmp_path / "mine"
    shared.mkdir()
    shared.chmod(mode)
    mine.write_text("mine", encoding="utf-8")
    for name in ("out.txt", ".out.part.txt"):
        (shared / name).symlink_to(mine)
    write_whole(shared / "out.txt", "ours")
    assert mine.read_text(encoding="utf-8") == "mine"
    assert (shared / "out.txt").read_text(encoding="utf-8") == "ours" and not (shared / "out.txt").is_symlink()
    assert sorted(path.name for path in shared.iterdir()) == [".out.part.txt", "out.txt"]


def test_a_file_that_others_could_exchange_is_filled_where_they_cannot(tmp_path: Path) -> None:
    """Libraries open it by its name, so that an exclusive opening of carom's own would not be enough."""
    shared = tmp_path / "shared"
    shared.mkdir()
    shared.chmod(0o777)
    with whole_file(shared / "out.zip") as part:
        assert part.is_relative_to(private_folder()) and part.suffix == ".zip"
        part.write_bytes(b"zip")
    assert (shared / "out.zip").read_bytes() == b"zip" and not part.exists()


def test_a_failure_leaves_the_old_file_and_no_other(tmp_path: Path) -> None:
    path = tmp_path / "out.txt"
    path.write_text("old", encoding="utf-8")
    with pytest.raises(KeyboardInterrupt), whole_file(path) as part:
        part.write_text("half", encoding="utf-8")
        raise KeyboardInterrupt
    assert path.read_text(encoding="utf-8") == "old" and [each.name for each in tmp_path.iterdir()] == ["out.txt"]
