"""A recording as a folder for a web host."""

from __future__ import annotations

import functools
import html.parser
import http.server
import json
import os
import re
import subprocess
import threading
from collections.abc import Iterator, Sequence
from pathlib import Path

import pytest
from PIL import Image

from browser import chromium, pixels_of, settled, wait_until_loaded
from carom.display import web
from carom.display.picture import Shot
from carom.recording.read.recording import Recording
from carom.recording.write.recorder import FrameRecorder
from carom.sharing import publish as publishing
from carom_command import carom
from needs import BROWSER, PICTURES
from scripted_run import ScriptedRun

PHONE = 360  # pixels of width, of a small phone
TITLE = "</title><script>document.title = 'taken'</script> & <b>$rows</b>"
SCENE = "#:schema scene.json\n# A ride.\n#\n# Look for: <b>circles</b>\n# that cross.\n# Change: nothing.\nseed = 1\n"
BETWEEN = 'body 1 "<img src=x onerror=alert(1)>" and body 2'


def record(path: Path, title: str = TITLE) -> Path:
    scripted = ScriptedRun(8, title=title, scene_toml=SCENE)
    impact: dict[str, float | str] = {"value": 3.0, "step": 40, "time": 2.0, "bodies": "1,2", "between": BETWEEN}
    most: dict[str, float | str] = {"value": 7.0, "step": 40, "time": 2.0}
    error: dict[str, float | str] = {"value": 1e-6, "step": 20, "time": 1.0}
    moments = {"impact": impact, "contacts": most, "energy_error": error}
    named = {f"moments.{name}.{key}": value for name, moment in moments.items() for key, value in moment.items()}
    with FrameRecorder(path, scripted.header) as recorder:
        for frame in scripted.frames(60):
            recorder.put(frame)
        recorder.finish("completed", named)
    return path


def draw(recording: Recording, shots: Sequence[Shot], size: tuple[int, int]) -> str:
    """Replace the rendering of pictures by one that takes no time."""
    for shot in shots:
        Image.new("RGB", size, "orange").save(shot.out_png)
    return ""


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A recording, with pictures and a viewer that cost nothing."""
    monkeypatch.setattr(publishing, "try_to_render", draw)
    monkeypatch.setattr(web, "_copy_web_viewer", lambda folder: None)
    return record(tmp_path / "my run.rrd")


class Texts(html.parser.HTMLParser):
    """The tags of a page and the text between them."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.text = ""
        self.feed(page)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))

    def handle_data(self, data: str) -> None:
        self.text += data


def test_the_page_has_the_summary_and_pictures_with_a_link_for_each_moment(run: Path) -> None:
    done = carom("publish", run.name, cwd=run.parent)
    assert done.returncode == 0, done.stderr
    folder = run.parent / "my run-page"
    assert "3 moments" in done.stdout and "-d 'my run-page'" in done.stdout
    assert (folder / "recording.rrd").read_bytes() == run.read_bytes()
    page = Texts((folder / "index.html").read_text(encoding="utf-8"))
    links = [attributes["href"] for tag, attributes in page.tags if tag == "a"]
    assert [link for link in links if link and "#" in link] == [
        "viewer.html#at=1500000000&show=moment-1",
        *2 * ["viewer.html#at=2000000000&show=moment-2"],
        "viewer.html#at=2950000000&show=moment-3",
    ]
    pictures = [attributes["src"] for tag, attributes in page.tags if tag == "img"]
    assert [picture for picture in pictures if picture not in links] == ["moment-3-energy.png"], "others in full size"
    assert pictures == [
        "moment-1-bodies.png",
        *("moment-2-bodies.png", "moment-2-close-up.png"),
        *("moment-3-bodies.png", "moment-3-energy.png"),
    ]
    for picture in pictures:
        assert picture is not None and Image.open(folder / picture).size == (1000, 640)
    for text in (
        TITLE,
        *("A ride.", "Look for: <b>circles</b> that cross.", "Change: nothing."),
        f"Hardest impact, 3 J of approach (½ μ v_n²), {BETWEEN}",
        "Most contacts, 7",
        "8 bodies",
        "completed",
    ):
        assert text in page.text
    assert page.text.index("t = 1.5 s: something at step 30") < page.text.index("A ride."), "warnings first"


def test_every_picture_says_in_words_what_it_shows(run: Path) -> None:
    other = record(run.parent / "other.rrd", "Another")
    assert carom("publish", run.name, other.name, "-o", "class", cwd=run.parent).returncode == 0
    for path in sorted((run.parent / "class").glob("*.html")):
        page = Texts(path.read_text(encoding="utf-8"))
        images = [attributes for tag, attributes in page.tags if tag == "img"]
        texts = [str(image.get("alt")) for image in images]
        assert all(texts) and len(set(texts)) == len(texts), "no two pictures have the same text"
        close = [str(image["src"]) for image in images if str(image.get("alt")).endswith(", close up")]
        assert close == [
            str(image["src"]) for image in images if "close-up" in str(image["src"]) and path.name != "index.html"
        ]


def test_a_phone_gets_a_picture_of_its_own_size(run: Path) -> None:
    assert carom("publish", run.name, cwd=run.parent).returncode == 0
    folder = run.parent / "my run-page"
    page = Texts((folder / "index.html").read_text(encoding="utf-8"))
    images = [tags["src"] for name, tags in page.tags if name == "img"]
    narrow = [tags["srcset"] for name, tags in page.tags if name == "source"]
    assert narrow == [f"{str(image).removesuffix('.png')}-narrow.png" for image in images] and narrow
    for name in narrow:
        with Image.open(folder / str(name)) as picture:
            assert picture.size == web.NARROW_SIZE


def test_pages_fit_a_phone(run: Path) -> None:
    """What a style sheet can do wrong is a width in pixels, a line that may not wrap, or a page scaled down."""
    assert carom("publish", run.name, cwd=run.parent).returncode == 0
    folder = run.parent / "my run-page"
    page = Texts((folder / "index.html").read_text(encoding="utf-8"))
    (scale,) = [tag["content"] for name, tag in page.tags if name == "meta" and tag.get("name") == "viewport"]
    assert scale == "width=device-width, initial-scale=1"
    style = (folder / "index.css").read_text(encoding="utf-8")
    rules = {name.strip(): body for name, body in re.findall(r"([^{}]+)\{([^{}]*)\}", style)}
    assert "nowrap" not in style and {"width: 100%", "height: auto"} <= {*re.split(r";\s*|\s{2,}", rules["img"])}
    wide = {
        name: float(rem) for name, body in rules.items() for rem in re.findall(r"[^-]min-width: ([0-9.]+)rem", body)
    }
    assert all(16 * rem < PHONE - 2 * 16 for rem in wide.values()), "in one column beside the margins of the page"
    assert not re.findall(r"[^-]width: [0-9.]+(px|rem)", style.replace("max-width", "").replace("min-width", ""))
    assert "overflow-x: auto" in rules[".wide,\npre"], "tables and scenes scroll in themselves"


def test_several_recordings_get_a_page_each_and_a_card_in_the_index(run: Path) -> None:
    """Files of the same name in two folders, or with names of other files of a page, do not get in each other's way."""
    (run.parent / "b").mkdir()
    others = [record(run.parent / name, "Another") for name in ("b/my run.rrd", "viewer.rrd")]
    done = carom("publish", run.name, *map(str, others), "-o", "class", cwd=run.parent)
    assert done.returncode == 0, done.stderr
    folder = run.parent / "class"
    index = Texts((folder / "index.html").read_text(encoding="utf-8"))
    links = [attributes["href"] for tag, attributes in index.tags if tag == "a"][:3]
    assert links == ["my-run.html", "my-run-2.html", "viewer-2.html"]
    assert index.text.count("Another") == 2 and index.text.count("something at step 30") == 3
    assert [tag for tag, _ in index.tags].count("img") == 3
    for link, recording in zip(links, (run, *others), strict=True):
        assert link is not None
        stem = link.removesuffix(".html")
        assert (folder / f"{stem}.rrd").read_bytes() == recording.read_bytes()
        page = (folder / link).read_text(encoding="utf-8")
        assert f"viewer.html#of={stem}&amp;at=2000000000&amp;show={stem}_2" in page and f"{stem}_2-close-up.png" in page
        assert 'href="index.html"' in page and (folder / f"{stem}.rbl").exists()


def test_no_text_of_the_recording_becomes_a_tag_of_a_page(run: Path) -> None:
    carom("publish", run.name, "-o", "out", cwd=run.parent)
    for name in ("index.html", "viewer.html"):
        page = Texts((run.parent / "out" / name).read_text(encoding="utf-8"))
        assert not {"b"} & {tag for tag, _ in page.tags}
        scripts = [attributes.get("src") or "" for tag, attributes in page.tags if tag == "script"]
        assert all(script.endswith(".js") for script in scripts)
        assert not any(name.startswith("on") for _, attributes in page.tags for name in attributes)


def test_the_pages_ask_no_other_host_for_anything(run: Path) -> None:
    carom("publish", run.name, "-o", "out", cwd=run.parent)
    for name in ("index.html", "viewer.html"):
        for tag, attributes in Texts((run.parent / "out" / name).read_text(encoding="utf-8")).tags:
            loaded = attributes.get("src") or (attributes.get("href") if tag == "link" else "") or ""
            assert "//" not in loaded and not loaded.startswith("/")


def test_a_folder_that_exists_is_replaced_only_when_forced(run: Path) -> None:
    carom("publish", run.name, "-o", "out", cwd=run.parent)
    before = (run.parent / "out" / "index.html").read_text(encoding="utf-8")
    refused = carom("publish", run.name, "-o", "out", cwd=run.parent)
    assert refused.returncode == 2 and "out: exists; give --force" in refused.stderr
    record(run, "Another title")
    assert carom("publish", run.name, "-o", "out", "--force", cwd=run.parent).returncode == 0
    after = (run.parent / "out" / "index.html").read_text(encoding="utf-8")
    assert before != after and "Another title" in after
    assert sorted(path.name for path in run.parent.iterdir()) == ["my run.rrd", "out"]


@pytest.mark.parametrize("name", ["notes.txt", "index.html", "recording.rrd", "moment-1-bodies.png"])
def test_a_folder_with_a_file_of_another_program_is_never_replaced(run: Path, name: str) -> None:
    folder = run.parent / "out"
    folder.mkdir()
    (folder / name).write_text("mine", encoding="utf-8")
    done = carom("publish", run.name, "-o", "out", "--force", cwd=run.parent)
    assert done.returncode == 2 and f"holds {name}, which carom did not write" in done.stderr
    assert (folder / name).read_text(encoding="utf-8") == "mine"


@pytest.mark.parametrize("change", ["edited", "linked", "added"])
def test_what_a_person_changed_in_a_published_folder_is_never_replaced(run: Path, change: str) -> None:
    carom("publish", run.name, "-o", "out", cwd=run.parent)
    mine, page = run.parent / "mine", run.parent / "out" / ("new.html" if change == "added" else "index.html")
    mine.write_text("mine", encoding="utf-8")
    page.unlink(missing_ok=True)
    if change == "linked":
        page.symlink_to(mine)
    else:
        page.write_text("mine", encoding="utf-8")
    done = carom("publish", run.name, "-o", "out", "--force", cwd=run.parent)
    assert done.returncode == 2 and f"holds {page.name}, " in done.stderr
    assert page.read_text(encoding="utf-8") == mine.read_text(encoding="utf-8") == "mine"


@pytest.mark.parametrize("files", [{"../my run.rrd": ""}, {"data": ""}, {"index.html": 3}, [], "text"])
def test_a_list_that_carom_did_not_write_deletes_nothing(run: Path, files: object) -> None:
    folder = run.parent / "out"
    (folder / "data").mkdir(parents=True)
    (folder / "data" / "notes.txt").touch()
    (folder / publishing.LIST).write_text(json.dumps({"files": files}), encoding="utf-8")
    assert carom("publish", run.name, "-o", "out", "--force", cwd=run.parent).returncode == 2
    assert run.exists() and (folder / "data" / "notes.txt").exists()


def test_what_a_killed_publication_left_is_not_in_the_way_of_the_next(run: Path) -> None:
    """A list is written before the files that it names."""
    folder = run.parent / "out"
    (folder / ".0123abcd.part").mkdir(parents=True)
    (folder / ".0123abcd.part" / "index.css").touch()
    (folder / "index.html").write_text("half", encoding="utf-8")
    (folder / publishing.LIST).write_text('{"files": {".0123abcd.part": "", "index.html": ""}}', encoding="utf-8")
    (run.parent / ".out.old").mkdir()  # of versions that renamed the folder
    done = carom("publish", run.name, "-o", "out", "--force", cwd=run.parent)
    assert done.returncode == 0, done.stderr
    assert not [path for path in folder.iterdir() if path.name.startswith(".")]
    assert "<title>" in (folder / "index.html").read_text(encoding="utf-8")


@pytest.mark.slow
@pytest.mark.parametrize("place", ["the current folder", "a link", "a mounted disk"])
def test_a_folder_that_cannot_be_renamed_is_published_to_again_and_again(run: Path, place: str) -> None:
    folder = run.parent / "out"
    folder.mkdir()
    cwd, name = run.parent, "out"
    if place == "the current folder":
        cwd, name = folder, "."
    elif place == "a link":
        name = "link"
        (run.parent / name).symlink_to(folder, target_is_directory=True)
    elif os.geteuid() != 0 or subprocess.run(["mount", "-t", "tmpfs", "tmpfs", folder], check=False).returncode:
        pytest.skip("only root can mount a disk")
    try:
        for title in ("One", "Two"):
            record(run, title)
            done = carom("publish", str(run), "-o", name, "--force", cwd=cwd)
            assert done.returncode == 0, done.stderr
            assert f"<title>{title}" in (folder / "index.html").read_text(encoding="utf-8")
    finally:
        if place == "a mounted disk":
            subprocess.run(["umount", folder], check=True)
    assert place != "a link" or (run.parent / name).is_symlink()


@pytest.mark.parametrize("error", [OSError(28, "No space left on device"), KeyboardInterrupt()])
def test_a_publication_that_fails_leaves_the_old_folder(
    run: Path, monkeypatch: pytest.MonkeyPatch, error: BaseException
) -> None:
    def fail(*_: object, **__: object) -> None:
        raise error

    carom("publish", run.name, "-o", "out", cwd=run.parent)
    before = {path.name: path.read_bytes() for path in (run.parent / "out").iterdir()}
    monkeypatch.setattr("carom.sharing.publish.write_page", fail)
    assert carom("publish", run.name, "-o", "out", "--force", cwd=run.parent).returncode != 0
    assert {path.name: path.read_bytes() for path in (run.parent / "out").iterdir()} == before
    assert sorted(path.name for path in run.parent.iterdir()) == ["my run.rrd", "out"]


def test_without_a_driver_the_page_has_no_pictures_and_the_command_says_why(
    run: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(publishing, "try_to_render", lambda *_: "it needs a Vulkan driver")
    done = carom("publish", run.name, "-o", "out", "--json", cwd=run.parent)
    assert done.returncode == 0 and json.loads(done.stdout)["picture"] == "it needs a Vulkan driver"
    page = Texts((run.parent / "out" / "index.html").read_text(encoding="utf-8"))
    assert not [tag for tag, _ in page.tags if tag == "img"]
    assert page.text.count("Open this moment in the viewer") == 3
    assert "Without pictures: it needs a Vulkan driver" in page.text


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["nothing.rrd"], "there is no recording at nothing.rrd"),
        (["my run.rrd", "-o", "no/such/folder"], "there is no folder no/such"),
        (["my run.rrd", "-o", "my run.rrd"], "my run.rrd: a file; name a folder"),
    ],
)
def test_a_mistake_is_one_sentence(run: Path, arguments: list[str], said: str) -> None:
    done = carom("publish", *arguments, cwd=run.parent)
    assert done.returncode == 2 and said in done.stderr and len(done.stderr.splitlines()) == 1


@pytest.fixture
def published(tmp_path: Path) -> Iterator[str]:
    """Yield the address of a published folder on a plain server of files."""
    run = record(tmp_path / "run.rrd")
    assert carom("publish", run.name, "-o", "out", cwd=tmp_path).returncode == 0
    handler = functools.partial(http.server.SimpleHTTPRequestHandler, directory=str(tmp_path / "out"))
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        yield f"http://127.0.0.1:{server.server_port}/"
        server.shutdown()
        thread.join()


CONTRASTS = """() => {  // of each text of a page to the ground behind it, by the formula of WCAG 2
  const channels = (colour) => colour.match(/[0-9.]+/g).map(Number);
  const ground = (element) => {
    const [red, green, blue, opacity = 1] = channels(getComputedStyle(element).backgroundColor);
    return opacity === 1 ? [red, green, blue] : ground(element.parentElement);
  };
  const luminance = (colour) => {
    const linear = colour.map((c) => (c <= 10.31 ? c / 3294.6 : ((c / 255 + 0.055) / 1.055) ** 2.4));
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2];
  };
  const texts = [...document.querySelectorAll("body *")].filter((element) =>
    [...element.childNodes].some((node) => node.nodeType === Node.TEXT_NODE && node.data.trim()));
  return texts.map((element) => {
    const ink = luminance(channels(getComputedStyle(element).color).slice(0, 3));
    const paper = luminance(ground(element));
    return [(Math.max(ink, paper) + 0.05) / (Math.min(ink, paper) + 0.05), element.innerText];
  });
}"""


@pytest.mark.slow
@pytest.mark.needs(BROWSER)
def test_every_text_of_a_page_is_legible_in_both_schemes_of_a_browser(run: Path) -> None:
    assert carom("publish", run.name, "-o", "out", cwd=run.parent).returncode == 0
    (index,) = (run.parent / "out").glob("index.html")
    grounds = []
    with chromium() as (page, _):
        for scheme in ("light", "dark"):
            page.emulate_media(color_scheme=scheme)
            page.goto(index.as_uri())
            page.eval_on_selector_all("details", "all => all.forEach((one) => { one.open = true; })")
            contrasts = page.evaluate(CONTRASTS)
            assert len(contrasts) > 30 and not [text for contrast, text in contrasts if contrast < 4.5], scheme
            grounds.append(int(pixels_of(page)[2, 2].max()))
    assert grounds[0] > 240 and grounds[1] < 30, "each scheme has its own ground"


@pytest.mark.slow
@pytest.mark.needs(PICTURES, BROWSER)
def test_a_browser_opens_the_page_and_a_moment_in_the_viewer(published: str) -> None:
    with chromium() as (page, errors):
        page.goto(published)
        assert page.title() == TITLE
        widths = page.eval_on_selector_all("img", "images => images.map((image) => image.naturalWidth)")
        assert widths == 5 * [1000]
        page.set_viewport_size({"width": PHONE, "height": 640})
        assert page.evaluate("document.documentElement.scrollWidth") <= PHONE, "no need to scroll sideways"
        assert page.eval_on_selector_all("img", "images => images.every((image) => image.clientWidth > 300)")
        page.set_viewport_size({"width": 800, "height": 500})
        page.emulate_media(color_scheme="dark")
        page.click("figure:nth-of-type(2) a")
        wait_until_loaded(page, errors)
        shown = settled(page)
        assert page.url.endswith("viewer.html#at=2000000000&show=moment-2")
    assert not errors
    bodies = shown[75:250, :440]
    assert (bodies.max(axis=2) - bodies.min(axis=2) > 60).mean() > 0.02, "bodies in the colours of their groups"
