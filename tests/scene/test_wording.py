"""Words in messages: names, counts, and commands that can be pasted into a shell."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest

import carom
from carom.scene.wording import (
    Names,
    bodies_called,
    body_called,
    body_key,
    command,
    command_of_a_file,
    counted,
    hypertext,
    in_one_line,
    in_series,
    literal,
    one_word,
)

NAMES = Names(["ball", "body 1", ""], ["floor", "plane 1", "wall at -x"])


def test_a_body_is_called_by_its_number_and_the_name_that_somebody_gave_it() -> None:
    assert [NAMES.of(end) for end in range(3)] == ['body 0 "ball"', "body 1", "body 2"]
    assert (body_key(0, "ball"), body_key(1, "body 1")) == ('body.0 ("ball")', "body.1")


def test_a_body_that_has_the_number_of_another_as_its_name_keeps_its_own() -> None:
    assert body_called(3, "body 7") == 'body 3 "body 7"'


def test_planes_and_walls_are_called_by_their_names() -> None:
    assert [NAMES.of(end) for end in range(3, 6)] == ["floor", "plane 1", "wall at -x"]
    assert NAMES.pair((0, 3)) == 'body 0 "ball" and floor'


def test_a_plane_whose_name_is_lost_is_called_by_its_number() -> None:
    assert NAMES.of(6) == "plane 3"


def test_many_bodies_are_listed_up_to_eight() -> None:
    assert bodies_called([0, 1], NAMES.bodies) == 'body 0 "ball" and body 1'
    assert in_series(["one"]) == "one"
    assert in_series([str(k) for k in range(11)]) == "0, 1, 2, 3, 4, 5, 6, 7 and 3 more"


def test_one_is_singular_and_all_other_numbers_are_plural() -> None:
    assert [counted(count, "body") for count in (0, 1, 2)] == ["0 bodies", "1 body", "2 bodies"]
    assert counted(1, "contact-step") == "1 contact-step" and counted(3, "contact-step") == "3 contact-steps"


def test_words_with_spaces_and_quotes_are_quoted() -> None:
    assert command("view", Path("runs/my run.rrd"), "--at", "1.5") == "carom view 'runs/my run.rrd' --at 1.5"
    assert shlex.split(command("replay", "it's.rrd")) == ["carom", "replay", "it's.rrd"]


def test_a_file_whose_name_begins_like_an_option_is_none() -> None:
    assert command("view", Path("-o.rrd"), "--at", -1) == "carom view ./-o.rrd --at -1"


@pytest.mark.parametrize(
    "text", ["carom run scene.toml --set 'time.duration=2 s'", "carom run 'it'\"'\"'s.toml'", "python made.py -n 3"]
)
def test_a_command_that_carom_recorded_is_shown_as_it_was(text: str) -> None:
    assert command_of_a_file(text) == text


@pytest.mark.parametrize(
    "text",
    [
        "carom run x; touch owned",
        "carom run $(touch owned)",
        "carom run `touch owned`",
        "carom run x && touch owned",
        "carom run x\ntouch owned",
        "carom run x > owned",
        "carom run 'x",
        "carom run x # \u202etouch",
    ],
)
def test_a_command_of_a_stranger_is_a_single_word_for_a_shell(text: str) -> None:
    shown = command_of_a_file(text)
    assert len(shlex.split(shown)) == 1 and "\n" not in shown and "\u202e" not in shown


def test_marks_of_the_direction_of_writing_are_escaped_everywhere() -> None:
    for mark in "\u061c\u200e\u200f\u202a\u202e\u2066\u2069":
        shown = f"\\u{ord(mark):04x}"
        assert hypertext(f"<{mark}>") == f"&lt;{shown}&gt;"
        assert literal(mark) == f"\\{shown}"


def test_no_command_is_put_together_without_quoting() -> None:
    unquoted = re.compile(r"carom [a-z]+ (-[^\s\"']+ )*\{")
    for path in Path(carom.__file__).parent.rglob("*.py"):
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), start=1):
            assert not unquoted.search(line), f"{path}:{number}: write it with carom.scene.wording: {line.strip()}"


@pytest.mark.parametrize("text", ["$(touch owned)", "1.0; touch owned", "", "-1", "1.0\n2", "\u202e1.0", "x" * 100])
def test_a_version_of_a_file_that_is_none_is_one_quoted_word(text: str) -> None:
    assert shlex.split(one_word(text)) == [in_one_line(text[:80])], "its beginning"
    assert all(one_word(version) == version for version in ("0.1.0.dev3+g1a2b3c", "rerun-sdk", "3.11.7"))
