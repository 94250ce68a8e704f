"""The manifest is right at every moment."""

from __future__ import annotations

import errno
import fcntl
import json
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from carom.errors import ExperimentError
from carom.lab.sweep.manifest import DONE, Folder, Manifest, clear, put, read
from carom.lab.sweep.plan import plan
from carom.lab.sweep.sweep_table import rows_of
from sweep_runs import write_scene


def begin(folder: Path, runs: int = 3) -> Manifest:
    return Manifest.begin(Folder(folder / "out"), plan(write_scene(folder), seeds=runs), "carom sweep")


def finish(manifest: Manifest, name: str) -> None:
    path = manifest.folder.whole(name)
    path.write_bytes(b"whole")
    manifest.enter(name, {"status": DONE, "outcome": "completed", "file": f"runs/{path.name}", "size": 5})


def test_a_saved_manifest_is_read_again(tmp_path: Path) -> None:
    manifest = begin(tmp_path)
    finish(manifest, "seed=6")
    manifest.save()
    assert read(manifest.folder).runs == list(manifest.runs.values())
    assert read(manifest.folder).counts == {"pending": 2, "done": 1}
    assert [point.name for point in begin(tmp_path).todo] == ["seed=5", "seed=7"]


@pytest.mark.parametrize("spoil", ["remove", "shorten"])
def test_a_run_whose_file_is_gone_or_short_is_missing(tmp_path: Path, spoil: str) -> None:
    manifest = begin(tmp_path)
    finish(manifest, "seed=6")
    path = manifest.folder.whole("seed=6")
    path.unlink() if spoil == "remove" else path.write_bytes(b"who")
    assert len(manifest.todo) == 3


def test_a_disk_that_is_full_leaves_the_file_of_before_and_then_gets_the_reserve(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    manifest = begin(tmp_path)
    manifest.save()
    before = manifest.folder.manifest.read_bytes()
    finish(manifest, "seed=6")
    full = {"left": 2}

    def fsync(descriptor: int) -> None:
        if full["left"]:
            full["left"] -= 1
            raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "fsync", fsync)
    with pytest.raises(OSError, match="No space"):
        manifest.save()
    assert manifest.folder.manifest.read_bytes() == before
    manifest.hold_room()
    manifest.save()  # the second failure gives up the reserve
    assert read(manifest.folder).counts == {"pending": 2, "done": 1}
    assert sorted(path.name for path in manifest.folder.root.iterdir() if path.name.endswith(".new")) == []


def test_a_file_is_as_before_or_whole(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "manifest.json"
    put(path, "before")
    seen = []
    monkeypatch.setattr(os, "fsync", lambda descriptor: seen.append(path.read_text(encoding="utf-8")))
    put(path, "after")
    assert seen == ["before", "after"]  # the content is durable before it has the name, and then the name


def test_a_manifest_of_something_else_is_refused(tmp_path: Path) -> None:
    manifest = begin(tmp_path)
    manifest.save()
    stored = json.loads(manifest.folder.manifest.read_text(encoding="utf-8"))
    for change, said in (
        ({"schema": 99}, "another version"),
        ({"runs": [{"name": 1, "unknown": 2}]}, "not a manifest"),
        ({"runs": 3}, "not a manifest"),
    ):
        manifest.folder.manifest.write_text(json.dumps(stored | change), encoding="utf-8")
        with pytest.raises(ExperimentError, match=said):
            begin(tmp_path)
    manifest.folder.manifest.write_text(json.dumps(stored | {"versions": {"carom": "0.0.1"}}), encoding="utf-8")
    with pytest.raises(ExperimentError, match=r"begun with carom 0\.0\.1"):
        begin(tmp_path)


def test_two_sweeps_at_once_do_not_share_a_folder(tmp_path: Path) -> None:
    folder = begin(tmp_path).folder
    with (
        folder.claimed(),
        pytest.raises(ExperimentError, match="another sweep is running"),
        Folder(folder.root).claimed(),
    ):
        pass


def test_a_sweep_runs_on_a_file_system_without_locks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise OSError(errno.ENOLCK, os.strerror(errno.ENOLCK))

    folder = begin(tmp_path).folder
    monkeypatch.setattr(fcntl, "flock", refuse)
    with folder.claimed(), pytest.raises(ValueError, match="its own"):
        raise ValueError("its own")


def test_clearing_a_folder_leaves_what_others_put_there(tmp_path: Path) -> None:
    manifest = begin(tmp_path)
    finish(manifest, "seed=6")
    manifest.list_tables()
    folder = manifest.folder
    ours = [*folder.tables, folder.failed("seed=7"), folder.attempt("seed=5")]
    theirs = [folder.root / name for name in ("notes.txt", "data/mine.csv", "runs/mine.rrd", "partial/mine.rrd")]
    for path in (*ours, *theirs):
        path.parent.mkdir(exist_ok=True)
        path.write_text("x", encoding="utf-8")
    clear(folder)
    assert {path for path in folder.root.rglob("*") if path.is_file()} == set(theirs)


@pytest.mark.parametrize("name", ["scene.toml", "table.csv", "runs/seed=6.rrd", "failed/seed=5.rrd"])
def test_a_folder_of_a_person_is_refused_before_a_file_in_it_is_replaced(tmp_path: Path, name: str) -> None:
    path = tmp_path / "out" / name
    path.parent.mkdir(parents=True)
    path.write_text("mine", encoding="utf-8")
    with pytest.raises(ExperimentError, match="choose another folder with -o"):
        begin(tmp_path)
    assert path.read_text(encoding="utf-8") == "mine"
    assert [each for each in (tmp_path / "out").rglob("*") if each.is_file()] == [path]


def test_a_table_that_a_person_put_there_meanwhile_is_not_replaced(tmp_path: Path) -> None:
    manifest = begin(tmp_path)
    manifest.folder.tables[1].write_text("mine", encoding="utf-8")
    with pytest.raises(FileExistsError, match="does not belong to this sweep"):
        manifest.list_tables()


def test_a_manifest_that_names_files_elsewhere_deletes_none(tmp_path: Path) -> None:
    manifest = begin(tmp_path)
    (tmp_path / "mine").mkdir()
    (manifest.folder.root / "data").symlink_to(tmp_path / "mine")
    others = [tmp_path / "notes.txt", tmp_path / "mine" / "notes.txt"]
    for path in others:
        path.touch()
    manifest.files |= {"data/notes.txt"}
    manifest.save()
    clear(manifest.folder)
    assert all(path.exists() for path in others) and not manifest.folder.manifest.exists()


@pytest.mark.parametrize("name", ["..", ".", "../notes.txt", "/notes.txt", "data/../../notes.txt", "a\0b"])
@pytest.mark.parametrize("key", ["files", "file", "name"])
def test_a_manifest_with_a_path_that_leads_elsewhere_is_refused(name: str, key: str, tmp_path: Path) -> None:
    manifest = begin(tmp_path)
    document = json.loads(manifest.folder.manifest.read_text(encoding="utf-8"))
    if key == "files":
        document["files"].append(name)
    else:
        document["runs"][0][key] = name
    manifest.folder.manifest.write_text(json.dumps(document), encoding="utf-8")
    for use in (read, clear):
        with pytest.raises(ExperimentError, match=r"is not (a file below the folder of the sweep|the name of a run)"):
            use(manifest.folder)
    assert manifest.folder.manifest.exists()


def test_a_manifest_whose_runs_lack_what_varies_is_refused(tmp_path: Path) -> None:
    manifest = begin(tmp_path)
    document = json.loads(manifest.folder.manifest.read_text(encoding="utf-8"))
    document["varied"].append("gravity.constant")
    manifest.folder.manifest.write_text(json.dumps(document), encoding="utf-8")
    with pytest.raises(ExperimentError, match=r"run 'seed=5' has no value of 'gravity\.constant', which varies"):
        read(manifest.folder)


def test_nothing_that_another_user_planted_is_followed(tmp_path: Path) -> None:
    """In a folder that is open to all, files of any name may be links to files of the one who makes the sweep."""
    out, mine = tmp_path / "out", tmp_path / "mine"
    out.mkdir()
    mine.write_text("mine", encoding="utf-8")
    for name in (".claim", ".manifest.json.new", ".scene.toml.new", "manifest.json"):
        (out / name).symlink_to(mine)
    with pytest.raises(ExperimentError, match=r"\.claim: cannot be opened"), Folder(out).claimed():
        pass
    with pytest.raises(ExperimentError, match="not a manifest of carom's"):
        begin(tmp_path)
    (out / "manifest.json").unlink()
    begin(tmp_path).save()
    assert mine.read_text(encoding="utf-8") == "mine"


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can give a link to another user")
@pytest.mark.parametrize("name", ["runs", "failed", "partial", "data"])
def test_a_subfolder_that_another_user_made_a_link_is_refused(tmp_path: Path, name: str) -> None:
    out = tmp_path / "out"
    out.mkdir()
    (out / name).symlink_to(tmp_path)
    Folder(out).refuse_links()  # the user's own links may lead to another disk
    os.lchown(out / name, 65534, 65534)
    with pytest.raises(ExperimentError, match=f"{name}: a link of another user"):
        Folder(out).refuse_links()


def mutants(document: Any, random: np.random.Generator) -> Iterator[Any]:
    """Yield a document with one value after the other exchanged for one of another kind, or taken away."""
    values: list[Any] = [None, 3, -1.5, "text", "\x1b[31m[/red]", [], {}, [[]], {"a": {}}, True, 10**400, float("nan")]
    values.append(json.loads("[" * 200 + "]" * 200))
    for path in places(document):
        for value in [values[k] for k in random.integers(len(values), size=2)] + [...]:
            copy = json.loads(json.dumps(document))
            node = copy
            for key in path[:-1]:
                node = node[key]
            if value is ...:
                del node[path[-1]]
            else:
                node[path[-1]] = value
            yield copy


def places(node: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    inner = node.items() if isinstance(node, dict) else enumerate(node) if isinstance(node, list) else ()
    for key, value in inner:
        yield (*path, key)
        yield from places(value, (*path, key))


def test_a_damaged_manifest_is_read_or_refused_in_one_sentence(tmp_path: Path, seed: int) -> None:
    manifest = begin(tmp_path)
    finish(manifest, "seed=6")
    manifest.save()
    whole = json.loads(manifest.folder.manifest.read_text())
    for mutant in mutants(whole, np.random.default_rng(seed)):
        manifest.folder.manifest.write_text(json.dumps(mutant))
        try:
            rows_of(read(manifest.folder).runs)
            _ = begin(tmp_path).todo
        except ExperimentError as error:
            assert "\n" not in str(error), f"seed {seed}"


@pytest.mark.parametrize(
    "text", ["", "[" * 100_000, '{"runs": ' * 5000, "3", "null", '{"schema": 1}', "\ud800", "1" * 5000]
)
def test_a_file_that_is_no_manifest_is_refused(text: str, tmp_path: Path) -> None:
    manifest = begin(tmp_path)
    manifest.folder.manifest.write_bytes(text.encode("utf-8", "surrogatepass"))
    with pytest.raises(ExperimentError, match=r"manifest\.json: not a manifest of carom's"):
        read(manifest.folder)


def test_a_file_that_does_not_fit_on_the_disk_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(descriptor: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError, match="No space left") as failed:
        put(tmp_path / "scene.toml", "x")
    assert failed.value.filename == str(tmp_path / "scene.toml") and not list(tmp_path.iterdir())
