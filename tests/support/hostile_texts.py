"""Hostile texts in scenes and in the properties of recordings, and all that carom prints and writes from them.

    python hostile_texts.py SEED COUNT

prints a line of JSON for each command: what it printed or wrote may neither steer a terminal nor reorder a line, no
command in it starts a second one, no page has a tag of it, no table a formula, and no Markdown a link.
"""

from __future__ import annotations

import csv
import json
import random
import re
import shlex
import subprocess
import sys
import tempfile
import unicodedata
import zipfile
from collections.abc import Iterator
from html.parser import HTMLParser
from io import StringIO
from pathlib import Path
from unittest.mock import patch
from xml.etree import ElementTree

import pyarrow as pa
from markdown_it import MarkdownIt

import carom
from carom.errors import SceneError
from carom.recording.read.recording import Recording
from carom.recording.rrd.framing import CHUNK
from carom.recording.rrd.messages import RECORDING, decode
from carom_command import carom as command
from edited_recordings import assembled, messages_of, repacked, stream, with_column

Attempt = dict[str, object]
TRACE = "PWNED"  # the file that a command of a text makes, if a shell runs it
PARTS = (
    *(f"$(touch {TRACE})", f"`touch {TRACE}`", f"; touch {TRACE};", f"\ntouch {TRACE}\n", f"' ; touch {TRACE} '"),
    *(f'" && touch {TRACE} "', f"| touch {TRACE}", f"& touch {TRACE} #", f">{TRACE}", f"\r\n```\ntouch {TRACE}\n```\n"),
    *("\x1b]0;owned\x07", "\x1b[2J", "\x9b31m", "\b\b\b", "\x1b]8;;http://evil.example\x1b\\x\x1b]8;;\x1b\\"),
    *("\u202egnp.exe", "\u2066x\u2069", "\u061c", "\u200f", "\u2028", "\x85", "\0", "[/red]", "[bold red]", "[link=x]"),
    *("<script>alert(1)</script>", "<img src=x onerror=alert(1)>", "</pre><b>x</b>", "'\"><svg onload=alert(1)>"),
    *("[x](javascript:alert(1))", "![x](http://evil.example/p.png)", "<http://evil.example>", "www.evil.example"),
    *("\n# heading", "| a | b |", "$$x$$", "\\u001b", "{0}", "%s", "${rows}", "=cmd|' /C calc'!A0", "@SUM(A1)", "-1+1"),
    *("\uff1dcmd", "\n=1+1", ";=1+1", "\ufeff=1+1", " =1+1", '"=1+1', "$x_{$", "$\\frac$", "\\$"),
    *("--force", "-o /etc/passwd", "../../x", "/etc/passwd", "a==1", "evil 1.0", "'; DROP", "\ud83d", "é́́", "x" * 300),
)
TEXTS = ("title", "description", "body", "material", "plane", "file")
COMMANDS = (
    *("inspect FILE", "inspect FILE --json", "replay FILE", "resume FILE -o more.rrd", "explain SCENE"),
    *("diff FILE OTHER", "why FILE --body 1 --at 0.3", "why FILE --body 1 --at 0.3 -o why.rrd", "view FILE"),
    *("contacts FILE --impacts", "contacts FILE --impacts -o table.csv", "contacts FILE --at 0.3"),
    *("export FILE -o table.csv", "report FILE -o bug.zip", "publish FILE -o page", "clip FILE --to 0.2 -o part.rrd"),
    *("clip FILE --bodies NAME -o part.rrd", "repair FILE -o fixed.rrd", "run SCENE -o again.rrd"),
    *("fork FILE --at 0.2 --perturb 1ulp -o fork.rrd", "sweep SCENE --vary seed=1,2 -o sweep"),
    *("fields FILE --cell 1 -o figure.svg", "contacts FILE --statistics -o figure.svg"),
    "shrink FILE --while 'impact of 0 and 1' -o small.toml",
)
PROGRAMS = ("carom", "pip", "python", "python3", "rerun", "uv")
HINT = re.compile(rf"(?:(?<=\s)|^)(?:{'|'.join(PROGRAMS)})\s[^\n]*", re.M)  # a command in a line, to be pasted
VERSIONS = re.compile(r"^\s*(?:versions|recorded with|replayed with) [^\n]*", re.M)  # name programs and start none
COMPOSED = ("why.rrd", "fork.rrd", "again.rrd")  # others are copies of what a stranger's file has
REORDERS = {"LRE", "RLE", "LRO", "RLO", "PDF", "LRI", "RLI", "FSI", "PDI"}
FORMULA = re.compile(  # numbers stay
    '["\\s\x00-\x20\x7f-\xa0\u200b-\u200f\u2028-\u202f\u2060\u3000\ufeff]*'
    "[=@+\uff1d\uff0b\uff0d\uff20-](?![0-9.einf]+(?:[eE][-+]?[0-9]+)?$)"
)


PAGE = frozenset(
    re.findall(
        r"\w+",
        "html head meta title link body main header footer nav article section div p a ul li dl dt dd h1 h2 pre code "
        "figure figcaption span img canvas table tr th td details summary script button input",
    )
)
TABLE = frozenset(("table", "caption", "tr", "th", "td", "p"))  # of a notebook
OWN_LINKS = ("data:,", "https://rerun.io")


def drawn(rng: random.Random) -> str:
    """Return a hostile text."""
    return "".join(rng.choice(PARTS) for _ in range(rng.choice((1, 1, 2, 4))))


class Tags(HTMLParser):
    """Collects what a page does that none of carom's does."""

    def __init__(self, text: str, allowed: frozenset[str]) -> None:
        super().__init__()
        self.allowed, self.found = allowed, list[str]()
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Judge a tag."""
        for name, value in attrs:
            leads_away = name in ("src", "href") and re.match(r"\s*[a-z]+:|//", value or "", re.IGNORECASE)
            if name.startswith("on") or (leads_away and value not in OWN_LINKS):
                self.found.append(f"{tag} {name}={value}")
        if tag not in self.allowed:
            self.found.append(tag)


def steers(text: str) -> list[str]:
    """Return what orders a terminal or the direction of writing."""
    marks = {
        each
        for each in text
        if (unicodedata.category(each) in ("Cc", "Zl", "Zp", "Cs") and each not in "\n\t")
        or unicodedata.bidirectional(each) in REORDERS
        or each in "\u200e\u200f\u061c"
    }
    return [f"orders {sorted(marks)!r}"] if marks else []


def pasted(text: str, folder: Path) -> list[str]:
    """Paste every command of a text into a shell that knows no program; return those that start another one."""
    faults = []
    for hint in set(HINT.findall(VERSIONS.sub("", text))):
        deaf = "".join(f"{name}() {{ :; }}; " for name in PROGRAMS) + hint
        started = ["bash", "-c", deaf.encode(errors="replace")]
        subprocess.run(started, cwd=folder, stdin=subprocess.DEVNULL, capture_output=True, check=False, timeout=30)
        if any(each.name.startswith(TRACE) for each in folder.iterdir()):
            faults.append(f"a shell would run {hint!r}")
        for each in folder.iterdir():
            each.unlink()
    return faults


def marked_up(text: str) -> list[str]:
    """Return links, pictures and tags of a Markdown text."""
    tokens = MarkdownIt("commonmark").enable(["table", "linkify"]).parse(text)
    spans = [*tokens, *(span for token in tokens for span in token.children or ())]
    bad = [span.type for span in spans if span.type in ("link_open", "html_inline", "html_block")]
    bad += [span.content for span in spans if span.type == "image" and span.content != "The moment"]
    return [f"Markdown has {bad}"] if bad else []


def faults_of(path: Path, empty: Path) -> Iterator[str]:
    """Judge a file that a command wrote."""
    if path.suffix == ".zip":
        with zipfile.ZipFile(path) as packed:
            readme = packed.read("README.md").decode()
        yield from [*steers(readme), *marked_up(readme), *pasted(readme, empty)]
    elif path.suffix == ".csv":
        for row in csv.reader(StringIO(path.read_bytes().decode(), newline="")):
            pieces = [piece for cell in row for piece in re.split("[;|\t\r\n]", cell)]
            yield from (f"a formula: {piece!r}" for piece in pieces if FORMULA.match(piece))
    elif path.suffix == ".html":
        text = path.read_text(encoding="utf-8")
        yield from [*steers(text), *(f"a page has {each}" for each in Tags(text, PAGE).found), *pasted(text, empty)]
    elif path.suffix == ".svg":
        drawn_text = "".join(ElementTree.parse(path).getroot().itertext())
        yield from steers(drawn_text)
    elif path.suffix == ".toml":
        text = path.read_text(encoding="utf-8")
        yield from [*steers(text), *pasted("\n".join(re.findall("^#.*$", text, re.M)), empty)]
    elif path.name in COMPOSED:
        for kind, body in messages_of(path):
            batch = decode(body)[1].batch if kind == CHUNK else None
            if batch is not None and "TextDocument:media_type" in batch.schema.names:
                types = batch["TextDocument:media_type"].to_pylist()
                for each, text in zip(types, batch["TextDocument:text"].to_pylist(), strict=True):
                    if each == ["text/markdown"]:
                        yield from [*steers(text[0]), *marked_up(text[0]), *pasted(text[0], empty)]


def scene_of(rng: random.Random) -> tuple[carom.Scene, dict[str, str]]:
    """Return a scene of two spheres that meet, with hostile names."""
    text = {name: drawn(rng) for name in TEXTS}
    bodies = [{"position": [x, 0.0, 0.0], "radius": 1.0, "mass": 1.0, "name": text["body"]} for x in (-1.2, 1.2)]
    bodies[0] |= {"velocity": [4.0, 0.0, 0.0], "material": text["material"]}
    scene = {
        "title": text["title"],
        "description": text["description"],
        "time": {"duration": 0.4},
        "material": [{"name": text["material"], "restitution": 0.5}],
        "body": bodies,
        "plane": [{"point": [0.0, 0.0, -5.0], "normal": [0.0, 0.0, 1.0], "name": text["plane"]}],
    }
    return carom.Scene.from_dict(scene), text


def altered(source: Path, out: Path, rng: random.Random) -> None:
    """Replace one text in three of the properties, the scene and the events of a recording."""
    parts = messages_of(source)
    for k, (kind, body) in enumerate(parts):
        store, chunk = decode(body) if kind == CHUNK else (None, None)
        if store is None or chunk is None or store.kind != RECORDING:
            continue
        batch = chunk.batch
        for name in chunk.components:
            kind_of = batch[name].type
            if not pa.types.is_list(kind_of) or kind_of.value_type != pa.string() or rng.random() > 1 / 3:
                continue
            if name.endswith((".bodies", ".planes")) or chunk.entity_path == "scene/toml":
                continue  # numbers; of another scene nothing is replayed
            given = batch[name].to_pylist()
            rows = [row and [drawn(rng).replace("\ud83d", "?") for _ in row] for row in given]
            batch = with_column(batch, name, pa.array(rows, kind_of))
        parts[k] = (CHUNK, repacked(body, stream(batch)))
    assembled(source, out, parts)


def attempts(rng: random.Random, folder: Path) -> Iterator[Attempt]:
    """Draw a scene and a recording of it, and have every command speak of them."""
    empty = folder / "empty"
    empty.mkdir(exist_ok=True)
    try:
        scene, text = scene_of(rng)
    except SceneError as error:
        yield {"command": "read", "said": str(error)[:200], "faults": [*steers(str(error))]}
        return
    stem = re.sub(r"[/\0\ud83d]", "_", text["file"])[:60]
    honest, odd, file = folder / "honest.rrd", folder / f"{stem}.rrd", folder / f"{stem}.toml"
    carom.run(scene, honest, force=True)
    file.write_text(scene.toml, encoding="utf-8")
    altered(honest, odd, rng)
    before = {honest, odd, file, empty}
    for path in (honest, odd):
        recording = Recording.open(path)
        faults = [*steers(repr(recording)), *steers(recording._repr_html_())]
        faults += Tags(recording._repr_html_(), TABLE).found
        yield {"command": f"a notebook shows {path.name}", "faults": faults}
    for template in COMMANDS:
        path = rng.choice((honest, odd))
        names = {"FILE": f"./{path.name}", "SCENE": f"./{file.name}", "OTHER": "honest.rrd", "NAME": text["body"]}
        words = [names.get(word, word).replace("\0", "") for word in shlex.split(template)]
        try:
            done = command(*words, cwd=folder)
        except Exception as error:
            yield {"command": f"{template} of {path.name!r}", "faults": [f"{type(error).__name__}: {error}"[:400]]}
            continue
        said = done.stdout + done.stderr
        faults = [*steers(said), *pasted(said, empty)]
        if done.returncode not in (0, 1, 2):
            faults.append(f"{done.returncode}: {said[-400:]}")
        written = [each for each in folder.rglob("*") if each.is_file() and each not in before]
        faults += [f"{each.name}: {fault}" for each in written for fault in faults_of(each, empty)]
        for each in written:
            each.unlink()
        yield {"command": f"{template} of {path.name!r}", "code": done.returncode, "faults": faults}


def main(seed: str, count: int) -> int:
    """Judge so many scenes; return the number of faults."""
    rng, faults = random.Random(seed), 0
    for _ in range(count):
        with (
            tempfile.TemporaryDirectory() as folder,
            patch("carom.sharing.report.try_to_render", lambda *_: "no pictures"),  # they have no texts
            patch("carom.sharing.publish.try_to_render", lambda *_: "no pictures"),
            patch("carom.display.web._copy_web_viewer", lambda _: None),
        ):
            for found in attempts(rng, Path(folder)):
                faults += bool(found["faults"])
                print(json.dumps(found), flush=True)  # noqa: T201
    return faults


if __name__ == "__main__":
    sys.exit(main(sys.argv[1], int(sys.argv[2])) > 0)
