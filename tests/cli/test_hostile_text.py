"""Titles and names are printed as they are: no markup, and no orders to the terminal."""

from __future__ import annotations

import json
from io import StringIO
from pathlib import Path

import pytest
from rich.table import Table
from rich.text import Text

from carom.cli.terminal import Terminal
from carom.scene.wording import escaped
from carom_command import carom
from edited_recordings import changed, mapped

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
