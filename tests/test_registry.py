"""Parts of installed packages: found by their entry points, and refused in one sentence where they are not right."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest
from pydantic import ValidationError

from carom import registry
from carom import run as carom_run
from carom.errors import SceneError
from carom.recording.schema.series import Series
from carom.runs.replay import replay
from carom.runs.resume import resume
from carom.scene.extensions import extensions_of, missing
from carom.scene.load import Scene
from carom.scene.schema.body import BodyData
from carom.scene.schema.contact import section_of
from carom_command import carom, with_paths

PAIR = {"body": [{"radius": 1.0, "position": [3.0 * k, 0, 0]} for k in range(2)]}


@pytest.fixture
def install(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Two packages: a module that cannot be imported, one that can, and a name that both define."""
    (tmp_path / "right_part.py").write_text(
        "from carom.recording.schema.series import SERIES\nPART, WRONG = SERIES[0], 7\n"
        "from carom.extend import BodyForce\nFORCE = BodyForce(section=3, acceleration=print)\n"
    )
    (tmp_path / "leaving_part.py").write_text("import sys\nsys.exit(0)\n")
    (tmp_path / "broken_part.py").write_text("import a_package_that_is_not_there\n")
    monkeypatch.syspath_prepend(tmp_path)
    one, other = ("one", "1.0"), ("other", "2.0")
    parts = {
        "series": {
            "right": (registry.PartOrigin("right_part:PART", *one),),
            "broken": (registry.PartOrigin("broken_part:PART", *one),),
            "twice": (registry.PartOrigin("right_part:PART", *one), registry.PartOrigin("right_part:PART", *other)),
        },
        "data_formats": {"csv": (registry.PartOrigin("right_part:PART", *one),)},
        "forces": {
            "pull": (registry.PartOrigin("broken_part:PART", *one),),
            "leaving": (registry.PartOrigin("leaving_part:PART", *one),),
            "wrong": (registry.PartOrigin("right_part:WRONG", *one),),
            "whole-module": (registry.PartOrigin("right_part", *one),),
            "without-section": (registry.PartOrigin("right_part:FORCE", *one),),
        },
        "contact_laws": {"leaving-law": (registry.PartOrigin("leaving_part:PART", *one),)},
        "walls": {"wrong-wall": (registry.PartOrigin("right_part:WRONG", *one),)},
        "commands": {"stay": (registry.PartOrigin("leaving_part:PART", *one),)},
    }
    monkeypatch.setattr(registry, "_installed", lambda: parts)


@pytest.mark.usefixtures("install")
def test_a_part_of_an_installed_package_is_found_by_its_name() -> None:
    assert isinstance(registry.load("series", "right"), Series)
    assert registry.installed("series") == ("broken", "right", "twice")


@pytest.mark.usefixtures("install")
@pytest.mark.parametrize(
    ("kind", "name", "sentence"),
    [
        ("series", "rihgt", 'no recorded series "rihgt"; did you mean "right"?'),
        ("engines", "unity", 'no engine "unity"'),
        ("commands", "dance", 'no command "dance"; there are stay'),
        ("series", "twice", 'the packages one and other both define a recorded series "twice"; uninstall one of them'),
        ("data_formats", "csv", 'the package one defines a data format "csv", which carom already has'),
        ("series", "broken", 'the recorded series "broken" of the package one 1.0 cannot be loaded: ModuleNotFound'),
        ("forces", "leaving", 'the force "leaving" of the package one 1.0 cannot be loaded: SystemExit: 0'),
        (
            "forces",
            "wrong",
            'the force "wrong" of the package one 1.0 cannot be loaded: TypeError: it is an object of ',
        ),
        ("walls", "wrong-wall", 'the shape of a wall "wrong-wall" of the package one 1.0 cannot be loaded: TypeError'),
        ("commands", "stay", 'the command "stay" of the package one 1.0 cannot be loaded: SystemExit: 0'),
    ],
)
def test_what_cannot_be_used_is_refused_in_one_sentence(kind: str, name: str, sentence: str) -> None:
    with pytest.raises(SceneError) as refused:
        registry.load(kind, name)
    assert str(refused.value).startswith(sentence) and "\n" not in str(refused.value)


BROKEN = {  # what a module does when it is imported, or its part when it is looked at
    "interrupts": "raise KeyboardInterrupt",
    "ends": "raise type('Other', (BaseException,), {})('x')",
    "leaves": "raise GeneratorExit",
    "calls-itself": "def f(): return f()\nf()",
    "no-text": "class Odd(Exception):\n    def __str__(self): raise SystemExit\nraise Odd",
    "steers": "raise ValueError('\\x1b[2J\\u202e\\nTraceback')",
    "gives-nothing": "def __getattr__(name): raise SystemExit(4)",
    "is-nothing": "class Odd:\n    @property\n    def __class__(self): raise KeyboardInterrupt\nPART = Odd()",
    "is-no-call": "class Odd:\n    @property\n    def __signature__(self): raise KeyboardInterrupt\n"
    "    def __call__(self): pass\nPART = Odd()",
    "has-odd-help": "def PART():\n    'x [/red]'",
    "has-odd-options": "def PART(a: 'raise SystemExit' = 1): pass",
}


@pytest.fixture
def odd_packages(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Packages that define a part of every kind, in modules that are broken in every way."""
    monkeypatch.syspath_prepend(tmp_path)
    parts: dict[str, dict[str, tuple[registry.PartOrigin, ...]]] = {kind: {} for kind in registry.KINDS}
    for name, text in BROKEN.items():
        (tmp_path / f"odd_{name.replace('-', '_')}.py").write_text(text, encoding="utf-8")
        for kind, known in parts.items():
            known[f"{name}-{kind[:3]}"] = (registry.PartOrigin(f"odd_{name.replace('-', '_')}:PART", name, "1.0"),)
    monkeypatch.setattr(registry, "_installed", lambda: parts)


@pytest.mark.usefixtures("odd_packages")
def test_no_broken_package_ends_a_command_that_does_not_use_it(tmp_path: Path) -> None:
    (tmp_path / "scene.toml").write_text("[[body]]\nradius = 1\n[time]\nduration = 0.01\n", encoding="utf-8")
    for words in (["--help"], ["scenes"], ["explain", "scene.toml"], ["run", "scene.toml", "-o", "run.rrd"]):
        done = carom(*words, cwd=tmp_path)
        assert done.returncode == 0, done.stderr
        assert "\x1b[2J" not in done.stdout + done.stderr
    for words in (["inspect", "run.rrd"], ["replay", "run.rrd"], ["export", "run.rrd", "-o", "table.csv"]):
        assert carom(*words, cwd=tmp_path).returncode == 0
    for name in BROKEN:
        done = carom(f"{name}-com", cwd=tmp_path)
        assert done.returncode == 2 and f"of the package {name} 1.0" in done.stderr, done.stderr


@pytest.mark.usefixtures("odd_packages")
@pytest.mark.parametrize("kind", registry.KINDS)
def test_a_broken_part_is_refused_in_one_sentence_where_it_is_used(kind: str) -> None:
    for name in ("interrupts", "ends", "leaves", "calls-itself", "no-text", "steers", "gives-nothing", "is-nothing"):
        if name != "is-nothing" or kind in registry.MADE_OF:  # it can be called otherwise
            with pytest.raises(SceneError, match=f"of the package {name} 1.0 cannot be loaded: ") as refused:
                registry.load(kind, f"{name}-{kind[:3]}")
            assert str(refused.value).isprintable()


def test_a_package_whose_metadata_are_damaged_is_left_out(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.syspath_prepend(tmp_path)
    right, metadata = b"[carom.forces]\nNAME = module:PART\n", b"Name: NAME\nVersion: 1.0\n"
    for name, entries, about in (
        ("good", right, metadata),
        ("binary", b"\xff\xfe[carom.forces]\nx=y:z\n", metadata),
        ("no-value", b"[carom.forces]\nnonsense\n", metadata),
        ("no-section", b"x = y\n[carom.forces\n", metadata),
        ("no-text", right, b"Name: \xff\nVersion: \xfe\n"),
        ("no-name", right, b"\0\1"),
        ("no-version", right, b"Name: NAME\n"),
    ):
        folder = tmp_path / f"{name}-1.0.dist-info"
        folder.mkdir()
        for file, text in (("entry_points.txt", entries), ("METADATA", about)):
            (folder / file).write_bytes(text.replace(b"NAME", name.encode()))
    found = registry._installed.__wrapped__()["forces"]
    assert found["good"] == (registry.PartOrigin("module:PART", "good", "1.0"),)
    assert set(found) & {"binary", "no-value", "nonsense", "no-section", "no-text", "x"} == set()
    assert found["no-version"] == (registry.PartOrigin("module:PART", "no-version", "?"),)


@pytest.mark.slow
def test_no_process_ends_by_packages_whose_metadata_are_damaged(tmp_path: Path) -> None:
    (tmp_path / "leaving.py").write_text("raise SystemExit(7)\n", encoding="ascii")
    for name, entries in (
        ("binary", b"\xff\xfe[carom.forces]\n"),
        ("no-value", b"[carom.forces]\nnonsense\n"),
        ("plugin", b"[pydantic]\nx = leaving:x\n"),
        ("numba", b"[numba_extensions]\ninit = leaving:x\n"),
    ):
        (tmp_path / f"{name}-1.0.dist-info").mkdir()
        (tmp_path / f"{name}-1.0.dist-info" / "entry_points.txt").write_bytes(entries)
        (tmp_path / f"{name}-1.0.dist-info" / "METADATA").write_text(f"Name: {name}\nVersion: 1.0\n", encoding="ascii")
    for words in (
        "--help",
        "explain two-spheres",
        "run two-spheres --set time.duration=0.01 -o run.rrd",
        "inspect run.rrd",
    ):
        ended = subprocess.run(
            [sys.executable, "-m", "carom", *words.split()],
            cwd=tmp_path,
            env=with_paths(tmp_path),
            capture_output=True,
            text=True,
            check=False,
        )
        assert ended.returncode == 0, ended.stderr[-300:]


@pytest.mark.usefixtures("install")
def test_broken_parts_harm_only_the_scenes_that_use_them() -> None:
    for kind in ("forces", "contact_laws", "walls"):
        for name in registry.installed(kind):
            section = section_of(kind, name)
            with pytest.raises(ValidationError, match=f'"{name}" of the package one 1.0'):
                section()


def test_a_scene_that_names_no_installed_part_says_so() -> None:
    with pytest.raises(SceneError, match=r"unknown key forces\.trap; no installed package has a force of that name"):
        Scene.from_dict(PAIR | {"forces": {"trap": {"frequency": 1.0}}})
    with pytest.raises(SceneError, match=r'record\.series: no recorded series "fastest"; no installed package has'):
        Scene.from_dict(PAIR | {"record": {"series": ["fastest"]}})


def test_a_scene_without_parts_of_packages_uses_none() -> None:
    assert extensions_of(Scene.from_dict(PAIR)) == {}


def test_a_recording_says_what_to_install() -> None:
    used = {"forces.trap": "carom-example 0.1.0", "series.fastest": "carom-example 0.1.0"}
    assert missing(used) == (
        'it uses the force "trap" and the recorded series "fastest" of the package carom-example 0.1.0, which is not '
        "installed. If you trust the sender of the file, who chose this name: pip install carom-example==0.1.0"
    )
    assert missing({}) == ""


@pytest.mark.parametrize(
    "package",
    [
        "$(id) 1",
        "evil; id 1",
        "evil `id`",
        "-r https://evil.example/x 1",
        "git+https://evil.example/x 1",
        "./evil 1",
        "evil 1 --index-url=https://evil.example",
        "evil[$(id)] 1",
        "evil\n1",
        "evil \u202e1",
        "evil 1.0+local",
        "evil 1..0",
        "evil 1!.+",
        "evil 01",
        "evil ١",
        "evil 1.0\n",
        "evil",
        "",
    ],
)
def test_no_command_contains_what_is_no_name_of_a_package_and_its_version(package: str) -> None:
    said = missing({"forces.x": package})
    assert "pip install" not in said and "\n" not in said and "\u202e" not in said


def test_the_name_of_a_part_cannot_look_like_another_line() -> None:
    assert "\n" not in missing({"forces.x\ncarom: run this": "carom-example 0.1.0"})


def test_versions_of_packages_with_extensions_are_said_as_caroms_own_are(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "versioned_part.py").write_text(
        "from carom.recording.schema.series import Series\n"
        "PART = Series('step/mine', '', 'mine', 0, None, lambda sample: float(sample.frame.step), 'steps')\n"
    )

    def install(version: str) -> None:
        parts = {"series": {"mine": (registry.PartOrigin("versioned_part:PART", "my-package", version),)}}
        monkeypatch.setattr(registry, "_installed", lambda: parts)

    install("1.0")
    scene = Scene.from_dict({"time": {"duration": 0.02}, "record": {"series": ["mine"]}, **PAIR})
    run = carom_run(scene, tmp_path / "run.rrd")
    assert run.versions["my-package"] == "1.0"
    install("2.0")
    result = replay(run)
    assert (result.recorded_with["my-package"], result.replayed_with["my-package"]) == ("1.0", "2.0")
    assert result.same and "my-package 1.0" in carom("replay", "run.rrd", cwd=tmp_path).stdout
    resumed = resume(run, 0.04, tmp_path / "more.rrd")
    assert (resumed.versions["my-package"], resumed.properties["resumed.version.my-package"]) == ("1.0", "2.0")
    carom_run(scene, tmp_path / "again.rrd")
    assert "version.my-package: 1.0 in A, 2.0 in B" in carom("diff", "run.rrd", "again.rrd", cwd=tmp_path).stdout
    assert "my-package 2.0" in carom("inspect", "again.rrd", cwd=tmp_path).stdout


@pytest.mark.parametrize(
    ("kind", "page", "heading"),
    [("data_formats", "data.md", "what is read"), ("export_formats", "sharing.md", "content")],
)
def test_the_table_of_the_docs_lists_each_format(kind: str, page: str, heading: str) -> None:
    text = (Path(__file__).parents[1] / "docs" / page).read_text(encoding="utf-8")
    table = text.partition(f"| ending | {heading} |\n|---|---|\n")[2].partition("\n\n")[0]
    endings = [ending for row in table.splitlines() for ending in re.findall(r"`(\.\w+)`", row.split("|")[1])]
    assert set(endings) == {f".{name}" for name in registry.HOUSE[kind]}


def test_the_help_of_data_files_names_only_formats() -> None:
    named = re.findall(r"\.[a-z0-9]+\b", (BodyData.model_fields["file"].description or "").partition(" or another")[0])
    assert named and {name[1:] for name in named} <= set(registry.HOUSE["data_formats"])
