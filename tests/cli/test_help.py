"""Help texts: what is written is what is shown."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from rich.markup import render
from typer.main import get_command

from carom.cli.main import app
from carom_command import carom

ROOT: Any = get_command(app)
COMMANDS: dict[str, Any] = {"carom": ROOT, **ROOT.commands}


@pytest.mark.parametrize("name", COMMANDS)
def test_no_help_text_loses_what_stands_in_brackets_to_markup(name: str) -> None:
    command = COMMANDS[name]
    for text in (command.help, *(parameter.help for parameter in command.params)):
        written = (text or "").replace("\\[", "[")
        assert render(text or "").plain == written


@pytest.mark.parametrize("name", COMMANDS)
def test_no_help_text_shows_the_name_of_a_constant_instead_of_its_value(name: str) -> None:
    for parameter in COMMANDS[name].params:
        assert not re.search(r"\{\w", parameter.help or "")


@pytest.mark.parametrize("name", COMMANDS)
def test_paragraphs_of_help_are_broken_where_the_terminal_ends_only(name: str) -> None:
    assert all("\n" not in paragraph for paragraph in (COMMANDS[name].help or "").split("\n\n"))


def test_help_with_the_name_of_a_command_is_the_help_of_that_command(tmp_path: Path) -> None:
    assert carom("help", "contacts", cwd=tmp_path).stdout == carom("contacts", "--help", cwd=tmp_path).stdout
    assert carom("help", cwd=tmp_path).stdout == carom("--help", cwd=tmp_path).stdout


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["contacts", "--foo"], "no such option"),
        (["pictur"], "no such command 'pictur'. Did you mean 'picture'?"),
        (["view"], "missing argument 'FILE'"),
        (["view", "a.rrd", "--at", "soon"], "invalid value for '--at': soon: expected a time"),
        (["view", "a.rrd", "b.rrd"], "got unexpected extra argument"),
    ],
)
def test_a_mistake_in_the_arguments_is_one_line_that_names_the_help(
    arguments: list[str], said: str, tmp_path: Path
) -> None:
    done = carom(*arguments, cwd=tmp_path)
    assert done.returncode == 2 and done.stderr.count("\n") == 1
    assert done.stderr.startswith(f"carom: {said}") and "see `carom help" in done.stderr.lower()


def test_a_quiet_command_prints_its_result_and_no_progress(tmp_path: Path) -> None:
    (tmp_path / "two.toml").write_text("[time]\nduration = 0.1\n[[body]]\n", encoding="utf-8")
    loud, quiet = (carom("run", "two.toml", "-f", *more, cwd=tmp_path) for more in ([], ["-q"]))
    assert "1 body" in loud.stderr and not quiet.stderr
    assert "completed" in loud.stdout and "completed" in quiet.stdout
    assert carom("run", "none.toml", "-q", cwd=tmp_path).stderr.startswith("carom: none.toml: no such file")


def test_a_verbose_command_prints_the_traceback_of_its_error(tmp_path: Path) -> None:
    brief, verbose = (carom("inspect", "none.rrd", *more, cwd=tmp_path).stderr for more in ([], ["-v"]))
    assert "Traceback" not in brief and "Traceback" in verbose and verbose.endswith(brief)


def test_the_help_of_a_sweep_names_the_section_of_the_scene(tmp_path: Path) -> None:
    shown = re.sub(r"[\s│]+", " ", carom("sweep", "--help", cwd=tmp_path).stdout)
    assert "[sweep] of the scene" in shown


@pytest.mark.parametrize("name", ["run", "sweep"])
def test_a_flag_does_not_look_as_if_it_took_a_value(name: str, tmp_path: Path) -> None:
    shown = carom(name, "--help", cwd=tmp_path).stdout
    (line,) = (line for line in shown.splitlines() if "--force" in line)
    assert "bool" not in shown and re.search(r"--force +-f +(Replace|Remove)", line)


def test_the_help_groups_the_commands_in_the_order_of_the_readme(tmp_path: Path) -> None:
    shown = carom("--help", cwd=tmp_path).stdout
    assert re.findall(r"╭─ ([A-Z][a-z ]+) ─", shown)[1:] == ["Simulate", "Look", "Ask", "Measure", "Keep and share"]
    tour = (Path(__file__).parents[2] / "README.md").read_text().partition("## Six things to do")[2]
    assert [title.split()[0] for title in re.findall(r"^\*\*(\w[^*]*)\.\*\*", tour, re.MULTILINE)[:5]] == [
        "Simulate",
        "Look",
        "Ask",
        "Measure",
        "Keep",
    ]


def test_force_means_in_every_command_that_something_is_replaced() -> None:
    for name, command in COMMANDS.items():
        for parameter in command.params:
            if "--force" in parameter.opts and not parameter.hidden:
                assert parameter.is_bool_flag, f"carom {name}"
                assert re.search("[Rr]eplace|[Rr]emove|in place of", parameter.help), f"carom {name}"


def test_explain_names_a_part_that_it_does_not_know(tmp_path: Path) -> None:
    said = carom("explain", "two-spheres", "--model", "spni", cwd=tmp_path)
    assert said.returncode == 2 and "--model spni: no part" in said.stderr


def test_the_shell_completes_commands_and_bundled_scenes(tmp_path: Path) -> None:
    def completed(words: str) -> list[str]:
        asked = {"_CAROM_COMPLETE": "complete_bash", "COMP_WORDS": words, "COMP_CWORD": str(words.count(" "))}
        program = "from carom.cli.main import app; app(prog_name='carom')"
        done = subprocess.run(
            [sys.executable, "-c", program],
            env={**os.environ, **asked},
            capture_output=True,
            text=True,
            check=False,
            cwd=tmp_path,
        )
        return done.stdout.split()

    assert completed("carom re") == ["resume", "replay", "repair", "report"]
    assert completed("carom run figure") == ["figure-eight"]
    assert "extremes/mass-ratio" in completed("carom explain extremes/")
