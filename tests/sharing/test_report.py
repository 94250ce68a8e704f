"""A bundle for a bug report: small, whole, and safe to open."""

from __future__ import annotations

import json
import zipfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from markdown_it import MarkdownIt

import carom
from carom.display.picture import Shot
from carom.errors import RecordingError
from carom.event import Event
from carom.recording.edit import bundle
from carom.recording.read.recording import Recording
from carom.runs.replay import replay
from carom.scene.load import Scene
from carom.scene.wording import command_of_a_file, escaped
from carom.sharing import report as reports
from carom.sharing.report import Report, report, worst_moment
from edited_recordings import changed, mapped
from small_scenes import cloud


@pytest.fixture(scope="module")
def rubble(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    return carom.run(
        Scene.load("rubble-collision", ["time.duration=6000.0"]), tmp_path_factory.mktemp("rubble") / "rubble.rrd"
    )


@pytest.fixture(scope="module")
def made(rubble: Recording) -> Report:
    return report(rubble, rubble.path.with_name("rubble.zip"))


@pytest.mark.slow
def test_a_report_has_all_that_its_reader_asks_for(rubble: Recording, made: Report) -> None:
    assert made.size == made.path.stat().st_size < 10_000_000
    assert "same bits" in made.replayed and made.picture == ""
    with zipfile.ZipFile(made.path) as packed:
        pictures = ["close-up.png", "environment.json", "picture.png"]
        assert sorted(packed.namelist()) == ["README.md", "clip.rrd", *pictures, "scene.toml"]
        text = packed.read("README.md").decode()
        assert packed.read("scene.toml").decode() == rubble.scene_toml
        assert packed.read("picture.png").startswith(b"\x89PNG")
        environment = json.loads(packed.read("environment.json"))
    assert environment["recorded"]["version.carom"] == environment["reported"]["version.carom"]
    for said in (rubble.title, "hardest impact", "restitution", "same bits", "carom replay rubble.zip"):
        assert said in text, said


@pytest.mark.slow
def test_the_clip_in_a_report_replays_from_the_zip_itself(rubble: Recording, made: Report) -> None:
    with bundle.opened(made.path) as path:
        clip = Recording.open(path)
        assert clip.frames == made.frames < rubble.frames
        assert replay(clip).same
    assert not path.exists(), "nothing is left behind"


def test_a_report_on_a_moment_has_that_moment_in_it(
    rubble: Recording, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(reports, "try_to_render", lambda *_: "not now")
    end = float(rubble.fingerprints()["time"][-1].as_py())
    made = report(rubble, tmp_path / "end.zip", at=end)
    with bundle.opened(made.path) as path:
        assert Recording.open(path).fingerprints()["time"].to_pylist()[-1] == end


@pytest.mark.slow
def test_a_clip_too_large_to_attach_gets_fewer_frames(
    rubble: Recording, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(reports, "ROOM", 1_500_000)
    monkeypatch.setattr(reports, "try_to_render", lambda *_: "not now")
    made = report(rubble, tmp_path / "small.zip")
    assert 1 < made.frames < reports.FRAMES and made.size < 1_500_000
    monkeypatch.setattr(bundle, "LARGEST", 1000)
    with pytest.raises(RecordingError, match="a bundle with a single frame would have"):
        report(rubble, tmp_path / "none.zip")
    assert not (tmp_path / "none.zip").exists()


def test_a_run_that_differs_says_so_in_its_report(
    cloud_run: Recording, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(reports, "try_to_render", lambda *_: "not now")
    monkeypatch.setattr("carom.state.frame.fingerprint_of", lambda time, arrays: 1)
    made = report(cloud_run, tmp_path / "cloud.zip")
    assert "it differs" in made.replayed


HOSTILE = "\x1b]0;owned\x07\u202e **bold** [a](https://x.test) ![i](//x.test/i.png) <img src=x> `c` | d \\ www"


def test_texts_of_a_recording_neither_format_a_report_nor_steer_a_terminal(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(reports, "try_to_render", lambda *_: "not now")
    scene = cloud(title=HOSTILE, description=f"Two lines\n===\n- {HOSTILE}\n12. item\n> quoted\n# heading")
    carom.run(scene, tmp_path / "cloud.rrd")
    odd = changed(
        tmp_path / "cloud.rrd",
        tmp_path / "odd.rrd",
        "__properties/run",
        mapped("command", lambda row: [f"{HOSTILE}\n# owned\n```"]),
        static=True,
    )
    changed(odd, odd, "__properties/run", mapped("version.carom", lambda row: ["$(touch owned)"]), static=True)
    made = report(Recording.open(odd), tmp_path / "odd.zip")
    with zipfile.ZipFile(made.path) as packed:
        text = packed.read("README.md").decode()
    assert not set("\x1b\x07\u202e\r") & set(text)
    page = MarkdownIt("commonmark").enable(["table", "strikethrough"]).parse(text)
    spans = [span for block in page for span in block.children or ()]
    heading = next(block for block in page if block.type == "inline").children or []
    assert "".join(span.content for span in heading) == escaped(HOSTILE)
    assert {span.type for span in spans} <= {"text", "strong_open", "strong_close", "code_inline", "softbreak"}
    assert sum(block.type == "heading_open" for block in page) == 3, "the title, energy, and how to look at it"
    (quote,) = [block for block in page if block.type == "blockquote_open"]
    assert (
        page[page.index(quote) + 1].type == "paragraph_open" and page[page.index(quote) + 4].type == "blockquote_close"
    )
    *_, line = [span.content for span in spans if span.type == "code_inline"]  # after the ways to open the clip
    assert line == command_of_a_file(f"{HOSTILE}\n# owned\n```"), "one quoted word"
    assert "The commands need the version of carom that recorded it" in text, "no version that is none"


def test_a_run_that_gained_energy_is_about_that(tmp_path: Path) -> None:
    scene = cloud(contact={"stabilisation": "baumgarte"}, record={"energy_tolerance": 1e-9})
    recording = carom.run(scene, tmp_path / "cloud.rrd")
    time, why = worst_moment(recording)
    assert why.startswith("Energy rose by") and 0.0 < time <= 3.0
    assert not why.endswith(".")  # it stands within a sentence


def test_the_subject_of_a_report_is_the_worst_that_went_wrong(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Two balls that start inside each other: the overlap gives a warning, and breaks a promise if there is one."""
    shots = list[Shot]()

    def only_look(recording: Recording, given: Sequence[Shot]) -> str:
        shots[:] = given
        return "not now"

    monkeypatch.setattr(reports, "try_to_render", only_look)
    document = {
        "title": "Two balls",
        "description": "Look at the overlap.\nIt is deep.",
        "body": [
            {"position": [0, 0, 0], "radius": 1.0, "mass": 1.0},
            {"position": [3, 0, 0], "radius": 1.0, "mass": 1.0, "velocity": [-1.7, 0, 0]},
        ],
        "gravity": {"constant": 0.0},
        "contact": {"timing": "end-of-step"},
        "time": {"duration": 3.0, "fixed_dt": 1.0},
        "record": {"every": "step"},
    }
    recording = carom.run(Scene.from_dict(document), tmp_path / "warned.rrd")
    time, why = worst_moment(recording)
    assert time == 1.0 and why == "the deepest overlap, 70% of the smaller radius, body 0 and body 1"
    made = report(recording, tmp_path / "warned.zip")
    assert [(shot.view, shot.request.event) for shot in shots] == [("bodies", "overlap"), ("close-up", "overlap")]
    with zipfile.ZipFile(made.path) as packed:
        text = packed.read("README.md").decode()
    order = (
        "The deepest overlap",
        "## Warnings (1)",
        "carom replay warned.zip",
        "carom view warned.zip --at 1",
        "versions",
    )
    assert [text.index(part) for part in order] == sorted(text.index(part) for part in order), "the worst first"
    assert "\n> Look at the overlap.\n> It is deep.\n" in text
    assert "## Warnings (1)" in text and "t = 1 s: Bodies overlap by more than 10% of the smaller radius;" in text

    promised = Scene.from_dict(document | {"expect": {"max_overlap": 0.1}})
    recording = carom.run(promised, tmp_path / "missed.rrd")
    time, why = worst_moment(recording)
    assert time == 1.0
    assert why == "the promise max_overlap was broken: 0.7, at most 0.1, body 0 and body 1"
    report(recording, tmp_path / "missed.zip")
    assert [shot.request.event for shot in shots] == ["overlap", "overlap"], "a close-up of the two that broke it"
    report(recording, tmp_path / "start.zip", 0.0)
    assert [(shot.view, shot.request.at) for shot in shots] == [("bodies", 0.0)]

    broken = Event(2, 2.0, "WARN", "Energy rose.", "energy-rise")
    not_finite = Event(3, 3.0, "WARN", "Two bodies are not finite.", "law-not-finite")
    monkeypatch.setattr(Recording, "warnings", lambda _: [broken, not_finite])
    assert worst_moment(recording) == (3.0, "Two bodies are not finite")
    monkeypatch.setattr(Recording, "warnings", lambda _: [broken])
    assert worst_moment(recording) == (2.0, "Energy rose")
    listing = Event(2, 2.0, "WARN", "Energy rose.\nCollisions in step 2:\n  body 0", "energy-rise")
    monkeypatch.setattr(Recording, "warnings", lambda _: [listing])
    assert worst_moment(recording) == (2.0, "Energy rose")
    with zipfile.ZipFile(report(recording, tmp_path / "listing.zip").path) as packed:
        text = packed.read("README.md").decode()
    assert "**Energy rose**, t = 2 s." in text
    assert "- t = 2 s: Energy rose.\n  - Collisions in step 2:\n  - body 0\n" in text


def test_a_report_of_a_run_without_contacts_is_about_its_last_frame(tmp_path: Path) -> None:
    fall = {"body": [{"position": [0, 0, 0]}], "gravity": {"uniform": [0, 0, -1]}, "time": {"duration": 1.0}}
    recording = carom.run(Scene.from_dict(fall), tmp_path / "fall.rrd")
    assert worst_moment(recording) == (1.0, "the last frame")


def test_a_report_that_is_not_called_a_zip_is_refused_before_it_is_made(rubble: Recording, tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"report.tar: a report is a \.zip"):
        report(rubble, tmp_path / "report.tar")
    assert not list(tmp_path.iterdir())


def test_a_recording_without_a_frame_has_nothing_to_report(
    cloud_run: Recording, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Recording, "frames", 0)
    with pytest.raises(RecordingError, match="holds no frame"):
        report(cloud_run, tmp_path / "cloud.zip")


def packed(path: Path, members: dict[str, bytes], **options: int) -> Path:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in members.items():
            archive.writestr(name, content, **options)
    return path


@pytest.mark.parametrize(
    ("members", "said"),
    [
        ({"../../evil.rrd": b"x"}, "there must be one clip.rrd in it, not 0"),
        ({"/etc/clip.rrd": b"x"}, "there must be one clip.rrd in it, not 0"),
        ({f"{k}": b"" for k in range(200)}, "200 files in it are too many"),
        ({"clip.rrd": bytes(300_000_000)}, "claims to unpack to 300000000 bytes"),
    ],
    ids=["zip-slip", "absolute", "many", "bomb"],
)
def test_a_hostile_bundle_is_refused_before_it_is_unpacked(
    members: dict[str, bytes], said: str, tmp_path: Path
) -> None:
    path = packed(tmp_path / "evil.zip", members)
    with pytest.raises(RecordingError, match=said), bundle.opened(path):
        pass
    assert [entry.name for entry in tmp_path.iterdir()] == ["evil.zip"]


def test_a_bundle_that_lies_about_its_size_is_refused(tmp_path: Path) -> None:
    path = packed(tmp_path / "liar.zip", {"clip.rrd": np.random.default_rng(1).bytes(5000)})
    raw = bytearray(path.read_bytes())
    for signature, offset in ((b"PK\x03\x04", 22), (b"PK\x01\x02", 24)):
        at = raw.index(signature) + offset
        raw[at : at + 4] = (100).to_bytes(4, "little")
    path.write_bytes(raw)
    with pytest.raises(RecordingError, match="not a bundle made by carom, or is damaged"), bundle.opened(path):
        pass


@pytest.mark.parametrize("size", [4, 100, 2000])
def test_a_torn_bundle_is_refused(size: int, tmp_path: Path) -> None:
    path = packed(tmp_path / "torn.zip", {"clip.rrd": np.random.default_rng(1).bytes(5000)})
    path.write_bytes(path.read_bytes()[:size])
    with pytest.raises(RecordingError, match="not a bundle made by carom, or is damaged"), bundle.opened(path):
        pass


def test_bundles_with_flipped_bytes_are_read_or_refused(rubble: Recording, tmp_path: Path) -> None:
    path, rng = tmp_path / "flipped.zip", np.random.default_rng(5)
    whole = packed(path, {"clip.rrd": rng.bytes(2000), "README.md": b"text"}).read_bytes()
    for _ in range(300):
        raw = bytearray(whole)
        for at in rng.integers(0, len(raw), rng.integers(1, 5)):
            raw[at] ^= 1 << rng.integers(0, 8)
        path.write_bytes(raw)
        try:
            with bundle.opened(path) as inside:
                assert inside.exists()
        except RecordingError:
            pass


@pytest.mark.parametrize("method", [zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA, 9, 99])
def test_a_bundle_packed_by_another_method_is_refused(method: int, tmp_path: Path) -> None:
    path = tmp_path / "odd.zip"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr(bundle.CLIP, b"x" * 1000)
    content = path.read_bytes()
    for place in (content.index(b"PK\x03\x04") + 8, content.index(b"PK\x01\x02") + 10):
        content = content[:place] + method.to_bytes(2, "little") + content[place + 2 :]
    path.write_bytes(content)
    with pytest.raises(RecordingError, match=f"compressed by method {method} instead of deflate"), bundle.opened(path):
        pass
