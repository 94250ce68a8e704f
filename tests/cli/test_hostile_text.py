"""Titles and names are printed as they are: no markup, and no orders to the terminal."""

from __future__ import annotations

import csv
import json
import re
from collections.abc import Iterator
from io import StringIO
from pathlib import Path
from xml.etree import ElementTree

import pyarrow as pa
import pytest
from markdown_it import MarkdownIt
from rich.table import Table
from rich.text import Text

from carom import run as carom_run
from carom.recording.export.spreadsheet import harmless
from carom.recording.read.recording import Recording
from carom.recording.rrd.framing import CHUNK
from carom.recording.rrd.messages import decode
from carom.scene.load import Scene
from carom.scene.wording import escaped, in_one_line
from carom.terminal.console import Terminal
from carom_command import carom
from edited_recordings import changed, mapped, messages_of, without_column

MARKUP = "![x](http://evil.example/p.png) <b>x</b> [y](javascript:alert(1)) `z` http://evil.example\n# w \u202e\u061c"
UNSAFE = "\x1b]0;owned\x07[/red] [bold]x[/] \x9b2J \u202egnp.exe \r\b"


def test_control_characters_are_escaped_as_json_escapes_them() -> None:
    assert escaped("a\x1b[31mb\tc\nd\x9be") == "a\\u001b[31mb\tc\nd\\u009be"
    assert json.loads(escaped(json.dumps(UNSAFE, ensure_ascii=False))) == UNSAFE
    assert escaped("Saturn’s rings – 5 × 10³ kg, ½ μ v²") == "Saturn’s rings – 5 × 10³ kg, ½ μ v²"


def _table(text: str) -> Table:
    table = Table.grid()
    table.add_row("title", text)
    return table


@pytest.mark.parametrize("made", [str, Text, _table], ids=["text", "rich text", "table"])
def test_a_terminal_prints_markup_as_it_is_and_obeys_nothing(made: object) -> None:
    out = StringIO()
    Terminal(file=out, force_terminal=True, color_system="truecolor", width=200).print(made(UNSAFE))  # type: ignore[operator]
    said = out.getvalue()
    assert "[/red] [bold]x[/]" in said
    assert not set("\x1b\x07\x9b\u202e\r\b") & set(said)


@pytest.mark.parametrize(
    ("entity", "component"),
    [
        ("__properties/carom", "title"),
        ("__properties/outcome", "outcome"),
        ("__properties/run", "version.carom"),
        ("__properties/run", "command"),
    ],
)
def test_no_text_of_a_recording_breaks_or_steers_a_command(entity: str, component: str, run_file: Path) -> None:
    folder = run_file.parent
    odd = changed(run_file, folder / "odd.rrd", entity, mapped(component, lambda row: [UNSAFE]), static=True)
    for command in (["inspect", odd.name], ["inspect", odd.name, "--json"], ["diff", run_file.name, odd.name]):
        done = carom(*command, cwd=folder)
        assert done.returncode == 0 and "Traceback" not in done.stderr, done.stderr
        assert not set("\x1b\x07\x9b\u202e\b") & set(done.stdout + done.stderr)
    shown = Recording.open(odd)
    for text in (repr(shown), shown._repr_html_()):
        assert not set("\x1b\x07\x9b\u202e\b") & set(text), "in a notebook"
    if component == "title":
        assert "[/red] [bold]x[/]" in carom("inspect", odd.name, cwd=folder).stdout
        assert json.loads(carom("inspect", odd.name, "--json", cwd=folder).stdout)["scene"]["title"] == UNSAFE


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (".".join(["a"] * 100_000) + " = 1", "nested more than 32 levels deep"),
        pytest.param("\n".join(f"k{n} = 1" for n in range(4000)), "more keys", marks=pytest.mark.slow),
    ],
    ids=["one long key", "many keys"],
)
def test_a_scene_of_any_keys_is_compared_or_refused(text: str, said: str, run_file: Path) -> None:
    odd = changed(
        run_file,
        run_file.with_name("odd.rrd"),
        "scene/toml",
        mapped("TextDocument:text", lambda row: [text]),
        static=True,
    )
    done = carom("diff", run_file.name, odd.name, cwd=run_file.parent)
    assert said in done.stdout + done.stderr and "Traceback" not in done.stderr
    assert len(done.stdout.splitlines()) < 100


def test_a_notebook_shows_why_a_recording_cannot_be_read(run_file: Path) -> None:
    odd = run_file.with_name("odd.rrd")
    changed(run_file, odd, "__properties/outcome", lambda batch: without_column(batch, "outcome"), static=True)
    assert "its property outcome has no outcome" in repr(Recording.open(odd))


def test_every_text_in_markdown_is_literal_in_what_carom_writes_for_the_viewer(tmp_path: Path) -> None:
    bodies = [{"position": [x, 0.0, 0.0], "radius": 1.0, "mass": 1.0, "name": MARKUP} for x in (-2.0, 2.0)]
    bodies[0]["velocity"] = [4.0, 0.0, 0.0]
    material = {"name": MARKUP, "restitution": 0.5}
    plane = {"point": [0.0, 0.0, -5.0], "normal": [0.0, 0.0, 1.0], "name": MARKUP}
    scene = Scene.from_dict(
        {
            "title": MARKUP,
            "time": {"duration": 1.0},
            "material": [material],
            "body": [body | {"material": MARKUP} for body in bodies],
            "plane": [plane],
        }
    )
    run = carom_run(scene, tmp_path / "run.rrd").path
    assert carom("why", run.name, "--body", "1", "--at", "1", "-o", "why.rrd", cwd=tmp_path).returncode == 0
    assert carom("fork", run.name, "--at", "0.5", "--perturb", "1ulp", "-o", "fork.rrd", cwd=tmp_path).returncode == 0
    for name in ("run.rrd", "why.rrd", "fork.rrd"):
        texts = list(markdown_of(tmp_path / name))
        assert texts, name
        for text in texts:
            tokens = MarkdownIt("commonmark").enable(["table", "linkify"]).parse(text)
            spans = [span for token in tokens for span in token.children or ()]
            assert not {span.type for span in spans} & {"link_open", "image", "html_inline"}, text
            assert "z" not in {span.content for span in spans if span.type == "code_inline"}
            assert "html_block" not in {token.type for token in tokens}
            assert sum(token.type == "heading_open" and token.tag == "h1" for token in tokens) <= 1
            assert not set("\u202e\u061c") & set(text)


def markdown_of(path: Path) -> Iterator[str]:
    for kind, body in messages_of(path):
        if kind != CHUNK:
            continue
        _, chunk = decode(body)
        if "TextDocument:text" in chunk.components and "TextDocument:media_type" in chunk.components:
            kinds = chunk.batch["TextDocument:media_type"].to_pylist()
            for kind_of, text in zip(kinds, chunk.batch["TextDocument:text"].to_pylist(), strict=True):
                if kind_of == ["text/markdown"]:
                    yield text[0]


FORMULA = "=cmd|' /C calc'!A0"


def test_no_name_of_a_column_or_a_body_is_a_formula_for_a_spreadsheet(tmp_path: Path) -> None:
    texts = [FORMULA, "+1", "-1", "@x", "\t=1", "plain", "1=2", None]
    table = harmless(pa.table({FORMULA: texts, "-x": [-1.0] * len(texts), "x": [1] * len(texts)}))
    assert table.column_names == [f"'{FORMULA}", "'-x", "x"]
    assert table.column(0).to_pylist() == [*(f"'{text}" for text in texts[:4]), "'\t'=1", "plain", "1=2", None]
    assert table.column(1).to_pylist() == [-1.0] * len(texts), "numbers stay"
    assert harmless(pa.table({"x": ["[1, -2.5e-3, 0]", "[-1, -2+cmd]"]}))["x"].to_pylist() == [
        "[1, -2.5e-3, 0]",
        "[-1,' -2+cmd]",
    ]
    # at once, after what begins a cell elsewhere, after what a spreadsheet drops, and in the letters of another script
    starts = ["", *";,|\n", "a;", "x\r\n", *' \ufeff\u00a0\u200b\0\x1b"', "b;  ", 'c;"']
    odd = [start + mark + "cmd" for start in starts for mark in "=+-@\uff1d\uff0b\uff0d\uff20"]
    for column in (pa.array(odd), pa.array(odd, pa.large_string()), pa.array(odd).dictionary_encode()):
        shown = harmless(pa.table({"x": column, odd[8]: column}))
        for cell in (*shown.column(0).to_pylist(), shown.column_names[1]):
            pieces = re.split(r"[;,|\t\r\n]", cell)
            assert not any(re.match("[^'a-z0-9]*[=+\\-@\uff1d\uff0b\uff0d\uff20]", piece) for piece in pieces), cell
    bodies = [{"position": [x, 0.0, 0.0], "radius": 1.0, "mass": 1.0, "name": FORMULA} for x in (-1.0, 1.0)]
    bodies[0]["velocity"] = [1.0, 0.0, 0.0]
    scene = Scene.from_dict({"time": {"duration": 0.2}, "gravity": {"constant": 0.0}, "body": bodies})
    run = carom_run(scene, tmp_path / "run.rrd").path
    printed = carom("contacts", run.name, "--impacts", "--csv", cwd=tmp_path).stdout
    written = carom("contacts", run.name, "--impacts", "-o", "table.csv", cwd=tmp_path)
    assert written.returncode == 0 and FORMULA in printed
    for text in (printed, (tmp_path / "table.csv").read_text(encoding="utf-8")):
        for row in csv.reader(text.splitlines()):
            assert not any(cell.startswith("=") for cell in row), row


@pytest.mark.parametrize("title", ["cost $x_{ $", "$\\badmacro{$", "\\$1 $ x_{ $ \\\\$", "one\x1b[2J\u202etwo"])
def test_no_title_of_a_recording_is_a_formula_of_a_figure(tmp_path: Path, title: str) -> None:
    pytest.importorskip("matplotlib")
    bodies = [{"position": [x, 0.0, 0.0], "radius": 1.0, "mass": 1.0} for x in (-2.0, 2.0)]
    run = carom_run(
        Scene.from_dict({"title": title, "time": {"duration": 0.1}, "body": bodies}), tmp_path / "r.rrd"
    ).path
    for words in (["fields", run.name, "--cell", "1"], ["contacts", run.name, "--statistics"]):
        done = carom(*words, "-o", "figure.svg", "--force", cwd=tmp_path)
        assert done.returncode == 0, done.stderr[-300:]
        drawn = "".join(ElementTree.parse(tmp_path / "figure.svg").getroot().itertext())
        assert "".join(in_one_line(title).split()) in "".join(drawn.split())
